// The page and the package in headless Chromium, whose WebGPU is SwiftShader: on the processor, everywhere the same.
// $CHROMIUM is the browser (/usr/bin/chromium), $SMR_GPU_PROGRAM what the boxes are held to, $SCREENSHOTS a folder for
// pictures of the page.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { after, before, test } from "node:test";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { chromium } from "playwright-core";

import { serve } from "./serve.js";

const ROOT = fileURLToPath(new URL("../../..", import.meta.url));
const SITE = fileURLToPath(new URL("../target/site", import.meta.url));
const PROGRAM = process.env.SMR_GPU_PROGRAM ?? join(ROOT, "target/release/smr-gpu");
const SAMPLES = readdirSync(join(ROOT, "samples")).filter((name) => name.endsWith(".png"));
const FLAGS = [
  "--enable-unsafe-webgpu",
  "--use-webgpu-adapter=swiftshader",
  "--enable-features=Vulkan",
  "--disable-vulkan-surface",
  "--use-fake-device-for-media-stream",
  "--use-fake-ui-for-media-stream",
];
// What `smr-gpu compare` allows a device: half of the last digit that is printed.
const BOUNDS = { score: 0.0005, box: 0.05, center_mm: 0.002 };

/** A document of the site in which nothing runs yet, and the page. */
const BARE = "style.css", PAGE = "";

let browser, site;

async function launch(args = FLAGS) {
  return chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    // Playwright's own headless mode is the old one.
    args: ["--headless=new", "--no-sandbox", ...args],
  });
}

before(async () => {
  site = await serve(SITE);
  browser = await launch();
});

after(async () => {
  await browser?.close();
  site?.server.close();
});

/** A page of the site; what it throws and nobody catches fails the test. */
async function open(t, path, options = {}) {
  const page = await (options.browser ?? browser).newPage(options);
  page.setDefaultTimeout(600_000);
  const thrown = [];
  page.on("pageerror", (error) => thrown.push(error));
  t.after(async () => {
    await page.close();
    assert.deepEqual(thrown, []);
  });
  if (options.before) await page.addInitScript(options.before);
  await page.goto(site.address + path);
  return page;
}

/** What `body`, given `argument` and the package, returns in a page, or the error that it throws. */
function inPage(page, body, argument) {
  return page.evaluate(
    async ([body, argument]) => {
      const smr = await import("/smr-gpu/index.js");
      const picture = async (path) => createImageBitmap(await (await fetch(path)).blob());
      try {
        return await new Function("smr", "picture", "argument", `return (${body})(smr, picture, argument)`)(smr, picture, argument);
      } catch (error) {
        return { name: error.name, kind: error.kind, message: error.message, ours: error instanceof smr.SmrGpuError };
      }
    },
    [body.toString(), argument],
  );
}

function program(...args) {
  const lines = execFileSync(PROGRAM, ["detect", "--json", "--sensor", "paper", ...args], { cwd: ROOT, encoding: "utf8" });
  return lines.trim().split("\n").map((line) => JSON.parse(line));
}

const largest = (one, other) => Math.max(...[one].flat().map((value, i) => Math.abs(value - [other].flat()[i])));

/** Holds an answer to the program's line, and returns how far they are apart. */
function same(found, line) {
  const own = new Set(["assumption"]);
  const files = new Set(["version", "file", "frame", "index", "time_s", "adapter"]);
  const names = (object, but) => Object.keys(object).filter((name) => !but.has(name)).sort();
  assert.deepEqual(names(found, own), names(line, files));
  for (const name of ["width", "height", "gel", "gel_assumed", "mm_per_pixel", "scale_from", "contact", "precision", "left_out", "regions"]) {
    assert.deepEqual(found[name], line[name], name);
  }
  assert.equal(found.detections.length, line.detections.length);
  const apart = { score: 0, box: 0, center_mm: 0 };
  for (const [i, snap] of found.detections.entries()) {
    const want = line.detections[i];
    assert.deepEqual(Object.keys(snap), Object.keys(want));
    assert.equal(snap.class, want.class);
    assert.equal(snap.class_index, want.class_index);
    assert.equal(snap.yaw_deg == null, want.yaw_deg == null);
    for (const name of Object.keys(apart)) {
      apart[name] = Math.max(apart[name], largest(snap[name], want[name]));
      assert.ok(apart[name] <= BOUNDS[name], `${name}: ${snap[name]}, ${want[name]}`);
    }
  }
  return apart;
}

const DETECT = async ({ Detector }, picture, { weights, samples }) => {
  const steps = [];
  const began = performance.now();
  const detector = await Detector.load({
    weights: `/weights/${weights}`,
    sensor: "paper",
    onProgress: (...step) => steps.push(step),
  });
  const load = performance.now() - began;
  const found = [];
  for (const sample of samples) {
    const source = await picture(`/samples/${sample}`);
    found.push([await detector.detect(source), await detector.detect(source)]);
    source.close();
  }
  const { adapter, classes, remarks } = detector;
  detector.close();
  return { adapter, classes, remarks, found, load, last: steps.at(-1) };
};

for (const [network, weights, samples] of [
  ["small", "smrnet-s.safetensors", SAMPLES],
  ["large", "smrnet.safetensors", ["mixed.png"]],
]) {
  test(`the ${network} network finds what the program finds`, async (t) => {
    const page = await open(t, BARE);
    const seen = await inPage(page, DETECT, { weights, samples });
    assert.ok(seen.found, JSON.stringify(seen));
    const bytes = readFileSync(join(ROOT, "weights", weights)).length;
    assert.deepEqual(seen.last, [bytes, bytes]);
    assert.deepEqual(seen.classes, ["A", "B"]);
    assert.match(seen.adapter, /swiftshader/i);
    const lines = program("--weights", join("weights", weights), "--device", "cpu", ...samples.map((name) => join("samples", name)));
    let snaps = 0;
    for (const [at, [first, again]] of seen.found.entries()) {
      const apart = same(first, lines[at]);
      snaps += first.detections.length;
      // One device and one choice of kernels: equal bits.
      assert.deepEqual(again.detections, first.detections);
      const figures = Object.entries(apart).map(([name, value]) => `${name} ${value.toExponential(1)}`);
      t.diagnostic(`${samples[at]}: ${first.detections.length} snaps, ${figures.join(", ")} apart; `
        + `${first.timings_ms.total.toFixed(0)} ms, again ${again.timings_ms.total.toFixed(0)} ms`);
    }
    assert.ok(snaps > 0);
    t.diagnostic(`on ${seen.adapter}: ready after ${(seen.load / 1e3).toFixed(1)} s`);
  });
}

test("pictures of all kinds give the same", async (t) => {
  const page = await open(t, BARE);
  const found = await inPage(page, async ({ Detector }, picture) => {
    const detector = await Detector.load({ weights: "/weights/smrnet-s.safetensors", mmPerPixel: 0.04 });
    const bitmap = await picture("/samples/hooks.png");
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0);
    const video = document.createElement("video");
    video.muted = true;
    const track = Object.assign(document.createElement("canvas"), { width: 1000, height: 1000 });
    const drawn = track.getContext("2d");
    drawn.drawImage(bitmap, 0, 0);
    video.srcObject = track.captureStream();
    const playing = video.play();
    drawn.drawImage(bitmap, 0, 0);
    await playing;
    const sources = {
      bitmap,
      again: bitmap,
      data: context.getImageData(0, 0, bitmap.width, bitmap.height),
      canvas,
      blob: await (await fetch("/samples/hooks.png")).blob(),
      video,
    };
    const found = {};
    for (const [kind, source] of Object.entries(sources)) found[kind] = (await detector.detect(source)).detections;
    // Asked for together, answered each.
    const both = await Promise.all([detector.detect(bitmap), detector.detect(bitmap)]);
    detector.close();
    return { ...found, first: both[0].detections, second: both[1].detections };
  });
  assert.ok(found.bitmap?.length >= 2, JSON.stringify(found));
  const { video, ...still } = found;
  for (const [kind, detections] of Object.entries(still)) assert.deepEqual(detections, found.bitmap, kind);
  // A video may round its colours on the way.
  assert.deepEqual(video.map((snap) => snap.class), found.bitmap.map((snap) => snap.class));
  for (const [i, snap] of video.entries()) assert.ok(largest(snap.box, found.bitmap[i].box) < 3, "video");
});

/** What stands in the README, in a document with a picture and a video. */
test("the README's snippets run", async (t) => {
  const text = readFileSync(join(ROOT, "bindings/web/README.md"), "utf8");
  const snippets = [...text.matchAll(/```js\n(.*?)```/gs)].map(([, snippet]) => snippet);
  const wanted = [/^[AB] [01]\.\d\d at -?\d+\.\d, -?\d+\.\d mm$/, /^\d+ snaps in \d+ ms$/, /^0 % apply_gates \/ .*: apply_gates\/\w+ in f32: [\d.]+ of its bound$/];
  assert.equal(snippets.length, wanted.length);
  for (const [at, snippet] of snippets.entries()) {
    const page = await open(t, BARE);
    await page.setContent('<img src="/samples/mixed.png"><video muted></video>', { waitUntil: "load" });
    const said = page.waitForEvent("console");
    await page.addScriptTag({ type: "module", content: snippet.replace('from "smr-gpu"', 'from "/smr-gpu/index.js"') });
    assert.match((await said).text(), wanted[at]);
  }
});

const LOAD = ({ Detector }, picture, options) => Detector.load(options).then(() => "loaded");

test("what is asked wrongly is said", async (t) => {
  const page = await open(t, BARE);
  const weights = "/weights/smrnet-s.safetensors";
  for (const [options, kind, words] of [
    [{ weights: "/weights/none.safetensors" }, "NoWeights", ["http://localhost", "/weights/none.safetensors", "404"]],
    [{ weights: "/samples/mixed.png" }, "Weights", ["mixed.png"]],
    [{ weights: "http://localhost:1/none" }, "NoWeights", ["http://localhost:1/none"]],
    [{}, "Param", ["weights"]],
    [{ weights, sensor: "digits" }, "Param", ["sensor", "`digits`", "gelsight-mini"]],
    [{ weights, sensor: { name: "mine", frame: "large" } }, "Sensor", ["large"]],
    [{ weights, scroe: 0.5 }, "Param", ["scroe"]],
    [{ weights, score: 2 }, "Param", ["score", "from 0 to 1", "2"]],
    [{ weights, classes: ["C"] }, "Param", ["classes", "A, B", "`C`"]],
    [{ weights, mmPerPixel: 7 }, "Param", ["scale", "7"]],
  ]) {
    const error = await inPage(page, LOAD, options);
    assert.equal(error.kind, kind, JSON.stringify({ options, error }));
    assert.ok(error.ours);
    for (const word of words) assert.ok(error.message.includes(word), `${word}: ${error.message}`);
  }
});

test("a picture that is none is said, and the next one is looked at", async (t) => {
  const page = await open(t, BARE);
  const elsewhere = await serve(SITE);
  t.after(() => elsewhere.server.close());
  const errors = await inPage(page, async ({ Detector }, picture, elsewhere) => {
    const detector = await Detector.load({ weights: "/weights/smrnet-s.safetensors", strictScale: true });
    const whole = await (await fetch("/samples/stud.png")).blob();
    const sources = {
      // A file that ends in its header, one that never was a picture, a video without a frame, nothing, a closed one.
      cut: whole.slice(0, 20),
      text: new Blob(["no picture"], { type: "image/png" }),
      video: document.createElement("video"),
      nothing: undefined,
      closed: await picture("/samples/stud.png"),
      // What a page may show and not read.
      foreign: Object.assign(new Image(), { src: `${elsewhere}samples/stud.png` }),
      unscaled: await picture("/samples/stud.png"),
    };
    sources.closed.close();
    await sources.foreign.decode();
    const errors = {};
    for (const [name, source] of Object.entries(sources)) {
      errors[name] = await detector.detect(source).then(() => null, ({ kind, message }) => ({ kind, message }));
    }
    detector.close();
    errors.after = await detector.detect(whole).then(() => null, ({ kind, message }) => ({ kind, message }));
    return errors;
  }, elsewhere.address);
  assert.equal(errors.foreign?.kind, "Picture", JSON.stringify(errors));
  assert.match(errors.foreign.message, /may read/);
  for (const name of ["cut", "text", "video", "nothing", "closed"]) {
    assert.equal(errors[name]?.kind, "Picture", JSON.stringify(errors));
    assert.match(errors[name].message, /^picture: expected/);
  }
  assert.equal(errors.unscaled.kind, "Scale");
  assert.equal(errors.after.kind, "Closed");
});

test("without WebGPU, and without an adapter", async (t) => {
  const page = await open(t, PAGE, { before: () => Object.defineProperty(navigator, "gpu", { value: undefined }) });
  await page.waitForSelector("#error:not([hidden])");
  assert.match(await page.textContent("#error"), /WebGPU: expected `navigator.gpu`.*Chrome/s);
  await page.click("#check");
  await page.waitForSelector("#verdict.failed");
  const error = await inPage(page, LOAD, { weights: "/weights/smrnet-s.safetensors" });
  assert.equal(error.kind, "NoWebGpu");

  const without = await launch(["--disable-gpu", "--disable-features=Vulkan", "--disable-software-rasterizer"]);
  t.after(() => without.close());
  const bare = await open(t, BARE, { browser: without });
  const none = await inPage(bare, LOAD, { weights: "/weights/smrnet-s.safetensors" });
  assert.ok(["NoAdapter", "NoWebGpu"].includes(none.kind), JSON.stringify(none));
});

/** The kernels of some operations, small cases of each kind: indices, sums, boxes, gates. */
test("kernels are within their bounds", async (t) => {
  const page = await open(t, BARE);
  const operations = ["softmax", "top_k", "decode_pose", "indirect_grid", "weighted_sum"];
  const steps = await inPage(page, async ({ check }, picture, operations) => {
    const steps = [];
    for (const operation of operations) for await (const step of check({ operation })) steps.push(step);
    return steps;
  }, operations);
  assert.ok(Array.isArray(steps), JSON.stringify(steps));
  assert.deepEqual([...new Set(steps.map((step) => step.operation))], operations);
  for (const { operation, case: name, kernels } of steps) {
    assert.ok(kernels.length > 0, `${operation}, ${name}`);
    for (const { kernel, precision, share, failures } of kernels) {
      assert.ok(kernel.startsWith(`${operation}/`) && ["f32", "f16"].includes(precision));
      assert.deepEqual(failures, []);
      assert.ok(share >= 0 && share <= 1, `${kernel}, ${name}: ${share}`);
    }
  }
  // A check that compares nothing would have no error at all.
  assert.ok(steps.some(({ kernels }) => kernels.some(({ share }) => share > 0.01)));
  assert.equal(steps.at(-1).done, 1);
  const error = await inPage(page, async ({ check }) => (await check({ operation: "none" }).next()).value);
  assert.equal(error.kind, "Param");
});

test("the page, wide and narrow", async (t) => {
  for (const [name, viewport] of [["wide", { width: 1280, height: 1000 }], ["narrow", { width: 390, height: 844 }]]) {
    const page = await open(t, PAGE, { viewport, deviceScaleFactor: 2 });
    await page.waitForSelector("#snaps:not([hidden])");
    assert.ok((await page.locator("#snaps tbody tr").count()) >= 2);
    assert.ok((await page.locator("#stages li").count()) >= 1);
    assert.match(await page.textContent("#adapter"), /swiftshader/i);
    assert.match(await page.textContent(".note"), /simulated pictures only/);
    // The middle of what is drawn is on the picture, and nothing is wider than the screen.
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth));
    const lines = await page.locator("#marks .line").count();
    assert.ok(lines >= 2, `${lines} lines`);

    await page.click("#check");
    await page.waitForFunction(() => document.querySelectorAll("#operations details").length >= 2);
    await page.click("#check");
    await page.waitForSelector("#verdict.ok");
    assert.match(await page.textContent("#verdict"), /^Stopped. All \d+ runs are within/);
    await page.locator("#operations summary").nth(0).click();
    if (process.env.SCREENSHOTS) {
      await page.screenshot({ path: join(process.env.SCREENSHOTS, `${name}.png`), fullPage: true });
    }
  }
});

test("the page takes files and the camera", async (t) => {
  const page = await open(t, PAGE);
  await page.waitForSelector("#snaps:not([hidden])");
  await page.setInputFiles("#file", { name: "broken.png", mimeType: "image/png", buffer: Buffer.from("no picture") });
  await page.waitForSelector("#error:not([hidden])");
  assert.match(await page.textContent("#error"), /^broken.png: expected a picture/);
  // Of a picture of one's own nobody knows the scale; 40 mm are right for this one.
  await page.setInputFiles("#file", join(ROOT, "samples/stud.png"));
  await page.waitForFunction(() => document.querySelector("#summary").textContent.startsWith("1 × B"));
  assert.equal(await page.inputValue("[name=scale]"), "");
  assert.ok(await page.isVisible("#assumption"));
  assert.ok(await page.isHidden("#error"));

  // A stated scale stays: the paper's sensor gives no frames of the camera's shape.
  await page.selectOption("[name=scale]", "paper");
  await page.click("#camera");
  await page.waitForSelector("#error:not([hidden])");
  assert.match(await page.textContent("#error"), /^sensor `paper`: expected frames .* got \d+ × \d+. Choose another/);
  assert.equal(await page.textContent("#camera"), "Open the camera");
  await page.selectOption("[name=scale]", "");
  await page.click("#camera");
  await page.waitForFunction(() => document.querySelector("#camera").textContent.startsWith("Close"));
  await page.waitForFunction(() => document.querySelector("#summary").textContent.endsWith("assumed"));
  assert.ok(await page.isHidden("#error"));
  await page.click("#camera");
  assert.equal(await page.textContent("#camera"), "Open the camera");
});

test("the module is small", (t) => {
  const module = readFileSync(join(SITE, "smr-gpu/wasm/smr_gpu_web_bg.wasm"));
  const packed = gzipSync(module, { level: 9 }).length;
  t.diagnostic(`${(module.length / 1e6).toFixed(2)} MB, ${(packed / 1e6).toFixed(2)} MB with gzip`);
  assert.ok(packed < 3e6, `${packed} bytes`);
});
