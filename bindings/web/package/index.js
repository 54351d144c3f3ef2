// The detector and the kernels' check for a page. All of it runs in a worker, so that a page never waits.

/** What went wrong; `kind` says which of the library's errors it is. */
export class SmrGpuError extends Error {
  constructor(kind, message, options) {
    super(message, options);
    this.name = "SmrGpuError";
    this.kind = kind;
  }
}

/** A worker, and the calls that it has not answered. */
class Remote {
  #worker;
  #calls = new Map();
  #next = 0;
  #ended = null;

  constructor() {
    if (!globalThis.navigator?.gpu) {
      const why = globalThis.isSecureContext === false
        ? "the page must come by https or from localhost"
        : "this browser has none, or it is switched off";
      throw new SmrGpuError("NoWebGpu", `WebGPU: expected \`navigator.gpu\`, got nothing; ${why}`);
    }
    this.#worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    this.#worker.onmessage = ({ data }) => this.#answered(data);
    this.#worker.onerror = (event) => {
      event.preventDefault();
      this.#end(new SmrGpuError("Internal", event.message || "the package's worker cannot be loaded"));
    };
  }

  #answered({ id, progress, value, error }) {
    const call = this.#calls.get(id);
    if (!call) return;
    if (progress) return call.onProgress?.(...progress);
    this.#calls.delete(id);
    if (error) call.reject(new SmrGpuError(error.kind, error.message));
    else call.resolve(value);
    // A panic leaves the module as it was: nothing more is to be had of it.
    if (error?.kind === "Internal") this.#end(new SmrGpuError(error.kind, error.message));
  }

  #end(error) {
    this.#ended ??= error;
    this.#worker.terminate();
    for (const call of this.#calls.values()) call.reject(this.#ended);
    this.#calls.clear();
  }

  call(method, args, { transfer = [], onProgress } = {}) {
    if (this.#ended) return Promise.reject(this.#ended);
    return new Promise((resolve, reject) => {
      const id = this.#next++;
      try {
        this.#worker.postMessage({ id, method, args }, transfer);
      } catch (cause) {
        // A picture of another site, or bytes that were given away.
        const message = `${method}: expected what this page may read, got ${cause.message}`;
        throw new SmrGpuError(method === "detect" ? "Picture" : "Param", message, { cause });
      }
      this.#calls.set(id, { resolve, reject, onProgress });
    });
  }

  close() {
    this.#end(new SmrGpuError("Closed", "it was closed"));
  }
}

/** What shows a picture, for the worker: an ImageData of bytes as it is, all else as an ImageBitmap. */
async function picture(source) {
  if (source instanceof ImageData && source.data instanceof Uint8ClampedArray) return source;
  try {
    // The numbers of the file, as other programs read them.
    return await createImageBitmap(source, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (cause) {
    const what = source?.constructor?.name ?? String(source);
    throw new SmrGpuError("Picture", `picture: expected one that the browser can show, got a ${what}: ${cause.message}`, {
      cause,
    });
  }
}

export class Detector {
  #remote;

  constructor(remote, about) {
    this.#remote = remote;
    Object.assign(this, about);
  }

  static async load({ weights, onProgress, ...options } = {}) {
    const isUrl = typeof weights === "string" || weights instanceof URL;
    if (!isUrl && !(weights instanceof ArrayBuffer) && !ArrayBuffer.isView(weights)) {
      throw new SmrGpuError("Param", "load: parameter `weights`: expected a URL or a file's bytes, got neither");
    }
    const from = isUrl ? new URL(weights, globalThis.document?.baseURI ?? globalThis.location.href).href : weights;
    const remote = new Remote();
    try {
      return new Detector(remote, await remote.call("load", [from, JSON.stringify(options)], { onProgress }));
    } catch (error) {
      remote.close();
      throw error;
    }
  }

  async detect(source) {
    const pixels = await picture(source);
    return this.#remote.call("detect", [pixels], { transfer: pixels instanceof ImageData ? [] : [pixels] });
  }

  close() {
    this.#remote.close();
  }
}

export async function* check({ operation } = {}) {
  const remote = new Remote();
  try {
    const { adapter, operations } = await remote.call("openChecks", []);
    const wanted = operation === undefined ? operations : [operation];
    for (const [at, operation] of wanted.entries()) {
      const cases = await remote.call("cases", [operation]);
      for (const [place, name] of cases.entries()) {
        const kernels = await remote.call("check", [place]);
        const done = (at + (place + 1) / cases.length) / wanted.length;
        yield { operation, case: name, kernels, done, adapter };
      }
    }
  } finally {
    remote.close();
  }
}
