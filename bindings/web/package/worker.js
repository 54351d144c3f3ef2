// Runs the WebAssembly module; index.js asks it by messages.

import init, { Checks, Detector } from "./wasm/smr_gpu_web.js";

let detector, checks;
const ready = init({ module_or_path: new URL("./wasm/smr_gpu_web_bg.wasm", import.meta.url) });
// Whoever asks hears of it.
ready.catch(() => {});

/** An error of a kind of the library's. */
function failure(kind, message) {
  return Object.assign(new Error(message), { name: kind });
}

/** The bytes of the file at a URL; tells how many there are so far, and of how many. */
async function download(url, tell) {
  const expected = `weights: expected a file at ${url}`;
  const response = await fetch(url).catch((error) => {
    throw failure("NoWeights", `${expected}, got no answer: ${error.message}`);
  });
  if (!response.ok) {
    throw failure("NoWeights", `${expected}, got ${response.status} ${response.statusText}`.trimEnd());
  }
  // Of what comes compressed the length is not known.
  const length = response.headers.get("content-encoding") ? 0 : Number(response.headers.get("content-length"));
  const parts = [];
  let loaded = 0;
  try {
    for (let reader = response.body.getReader(); ; ) {
      const { done, value } = await reader.read();
      if (done) break;
      parts.push(value);
      tell((loaded += value.length), length || null);
    }
  } catch (error) {
    throw failure("NoWeights", `${expected}, got ${loaded} bytes of it: ${error.message}`);
  }
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}

/** Width, height and the bytes of red, green, blue and alpha. */
function pixels(picture) {
  if (picture instanceof ImageData) return [picture.width, picture.height, picture.data];
  const { width, height } = picture;
  try {
    const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    return [width, height, context.getImageData(0, 0, width, height).data];
  } catch (error) {
    throw failure("Picture", `picture: expected one that fits in memory, got ${width} × ${height} pixels: ${error.message}`);
  } finally {
    picture.close();
  }
}

/** The name of the adapter that the module opens. */
async function adapter() {
  const { info } = (await navigator.gpu.requestAdapter({ powerPreference: "high-performance" })) ?? {};
  const name = info?.description || [info?.vendor, info?.architecture].filter(Boolean).join(" ");
  return name || "a GPU that the browser does not name";
}

const methods = {
  async load(tell, weights, options) {
    const isUrl = typeof weights === "string";
    const bytes = isUrl
      ? await download(weights, tell)
      : new Uint8Array(ArrayBuffer.isView(weights) ? weights.buffer : weights, weights.byteOffset ?? 0, weights.byteLength);
    detector = await Detector.load(isUrl ? weights.split("/").pop() : "weights", bytes, options);
    return { adapter: await adapter(), classes: detector.classes, remarks: detector.remarks };
  },
  async detect(tell, picture) {
    return JSON.parse(await detector.detect(...pixels(picture)));
  },
  async openChecks() {
    checks = await Checks.open();
    return { adapter: await adapter(), operations: checks.operations() };
  },
  cases(tell, operation) {
    return checks.cases(operation);
  },
  async check(tell, place) {
    return JSON.parse(await checks.run(place));
  },
};

self.onmessage = async ({ data: { id, method, args } }) => {
  try {
    if (!navigator.gpu) throw failure("NoWebGpu", "WebGPU: expected `navigator.gpu` in a worker, got nothing");
    await ready;
    const value = await methods[method]((...progress) => self.postMessage({ id, progress }), ...args);
    self.postMessage({ id, value });
  } catch (error) {
    const { name, message } = error;
    // What the browser itself throws is none of the library's errors.
    const kind = error.constructor === Error ? name : "Internal";
    self.postMessage({ id, error: { kind: kind === "Error" ? "Internal" : kind, message } });
  }
};
