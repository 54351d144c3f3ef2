// The page: pictures, samples and the camera in; boxes, arrows, millimetres and times out; and the kernels' check.

import { Detector, check } from "./smr-gpu/index.js";

const SAMPLES = ["mixed", "hooks", "stud", "faint_stud", "lettering"];
// Okabe and Ito's palette, light enough for black letters: the program's.
const COLOURS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#cc79a7"];

const $ = (id) => document.getElementById(id);
const canvas = $("picture"), marks = $("marks"), settings = $("settings");

/** An element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function shape(tag, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text) made.textContent = text;
  marks.append(made);
}

function busy(text) {
  $("busy").textContent = text ?? "";
  $("busy").hidden = !text;
}

function failed(error) {
  busy();
  const hint = error.kind === "NoWebGpu" || error.kind === "NoAdapter"
    ? " Chrome and Edge have WebGPU on Windows, macOS and Android, Safari from version 26, Firefox on Windows and macOS; on Linux it may have to be switched on."
    : error.kind === "Sensor" || error.kind === "Scale" ? " Choose another sensor or scale." : "";
  $("error").textContent = `${error.message.replace(/\.$/, "")}.${hint}`;
  $("error").hidden = false;
}

// The detector.

/** Of the settings as they are; a newer one takes its place. */
let detector;

/** Whether the visitor chose the scale: else the samples' is known, and no other. */
let isChosen = false;

function scaleOf(scale) {
  const { elements } = settings;
  if (isChosen || elements.scale.value === scale) return;
  elements.scale.value = scale;
  load();
}

function load() {
  const { weights, scale, mm } = Object.fromEntries(new FormData(settings));
  detector?.then((old) => old.close(), () => {});
  const options = scale === "stated" ? { mmPerPixel: Number(mm) } : scale ? { sensor: scale } : {};
  busy("Loading the network…");
  const onProgress = (loaded, total) => {
    const of = total ? ` of ${(total / 1e6).toFixed(1)}` : "";
    busy(loaded === total ? "Making the GPU ready…" : `Loading the network: ${(loaded / 1e6).toFixed(1)}${of} MB`);
  };
  detector = Detector.load({ weights: `weights/${weights}`, onProgress, ...options });
  detector.then(({ adapter }) => ($("adapter").textContent = adapter), () => {});
}

// Pictures.

/** What is shown, to be looked at again with other settings. */
let shown, found;
let stream;

function paint(source) {
  canvas.width = source.width;
  canvas.height = source.height;
  canvas.getContext("2d").drawImage(source, 0, 0);
}

/** Looks at a picture, unless another was asked for meanwhile. A camera's is shown with what was found in it. */
async function look(source) {
  $("error").hidden = true;
  const asked = detector;
  try {
    if (source !== shown) {
      shown?.close?.();
      shown = source;
      if (!stream) {
        paint(source);
        forget();
      }
    }
    const looking = await asked;
    if (!stream) busy("Looking…");
    const answer = await looking.detect(source);
    if (source !== shown || asked !== detector) return;
    found = answer;
    if (stream) paint(source);
    busy();
    show(looking.classes);
  } catch (error) {
    if (source !== shown || asked !== detector) return;
    if (stream) paint(source);
    stopCamera();
    forget();
    failed(error);
  }
}

async function open(from, scale = "") {
  stopCamera();
  press(null);
  scaleOf(scale);
  try {
    const blob = typeof from === "string" ? await download(from) : from;
    await look(await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" }));
  } catch (error) {
    failed(new Error(`${from.name ?? from}: expected a picture, got what the browser cannot show: ${error.message}`));
  }
}

async function download(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${response.status} ${response.statusText}`);
  return response.blob();
}

async function openCamera() {
  const video = element("video", { muted: true, playsInline: true });
  try {
    const own = await navigator.mediaDevices.getUserMedia({ video: { width: { ideal: 1280 } } });
    stopCamera();
    stream = own;
    video.srcObject = own;
    await video.play();
    press(null);
    scaleOf("");
    $("camera").textContent = "Close the camera";
    while (stream === own) {
      await look(await createImageBitmap(video));
      // Leaves the page its turn, also where looking fails at once.
      await new Promise(requestAnimationFrame);
    }
  } catch (error) {
    stopCamera();
    failed(new Error(`camera: expected a picture, got ${error.message || error.name}`));
  }
}

function stopCamera() {
  stream?.getTracks().forEach((track) => track.stop());
  stream = null;
  $("camera").textContent = "Open the camera";
}

// What was found.

const colour = (snap) => COLOURS[snap.class_index % COLOURS.length];
const fixed = (number, digits) => number.toFixed(digits).replace("-", "−");

/** Nothing is known of a picture that nobody looked at. */
function forget() {
  found = null;
  marks.replaceChildren();
  $("summary").textContent = "Nothing yet.";
  for (const id of ["snaps", "assumption"]) $(id).hidden = true;
  $("total").textContent = "";
  $("stages").replaceChildren();
}

function show(classes) {
  const counts = classes.map((name) => [found.detections.filter((snap) => snap.class === name).length, name]);
  const said = counts.filter(([count]) => count).map(([count, name]) => `${count} × ${name}`).join(", ");
  const scale = { stated: "as stated", sensor: "the sensor's", assumed: "assumed" }[found.scale_from];
  $("summary").replaceChildren(
    said || "No snap.",
    element("span", { className: "hint" }, ` at ${found.mm_per_pixel.toPrecision(3)} mm a pixel, ${scale}`),
  );
  $("assumption").textContent = found.assumption;
  $("assumption").hidden = !found.assumption;
  $("snaps").hidden = !said;
  $("snaps").tBodies[0].replaceChildren(...found.detections.map(row));
  const { stages, total } = found.timings_ms;
  $("total").textContent = `${fixed(total, 0)} ms from the picture to the boxes`;
  const longest = Math.max(...stages.map((stage) => stage.ms));
  $("stages").replaceChildren(...stages.map(({ stage, ms }) => {
    const bar = element("b");
    bar.style.width = `${(100 * ms) / longest}%`;
    return element("li", {}, element("span", {}, stage), bar, element("span", {}, `${fixed(ms, 1)} ms`));
  }));
  draw();
}

function row(snap) {
  const spread = (value, unit, digits) => value == null ? "" : element("small", {}, `± ${fixed(value, digits)}${unit}`);
  const swatch = element("i", { className: "swatch" });
  swatch.style.background = colour(snap);
  const [x, y] = snap.center_mm;
  return element("tr", {},
    element("td", {}, swatch, snap.class),
    element("td", {}, snap.score.toFixed(2)),
    element("td", {}, `${fixed(x, 2)}, ${fixed(y, 2)}`, spread(snap.center_std_mm && Math.max(...snap.center_std_mm), " mm", 2)),
    element("td", {}, snap.yaw_deg == null ? "–" : `${fixed(snap.yaw_deg, 0)}°`, spread(snap.yaw_std_deg, "°", 0)));
}

/** Boxes, arrows and labels, in lines and letters of one size on the screen. */
function draw() {
  marks.replaceChildren();
  if (!found) return;
  const { width, height } = found;
  marks.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const pixel = width / (marks.clientWidth || width);
  if (found.regions) {
    const all = `M0 0H${width}V${height}H0Z`;
    const holes = found.regions.map(({ x, y, width, height }) => `M${x} ${y}v${height}h${width}v${-height}Z`);
    shape("path", { d: all + holes.join(""), class: "dim" });
  }
  const both = (d, stroke) => {
    shape("path", { d, class: "rim", "stroke-width": 4.5 * pixel });
    shape("path", { d, class: "line", stroke, "stroke-width": 2.5 * pixel });
  };
  // The best on top.
  for (const snap of found.detections.toReversed()) {
    const [x1, y1, x2, y2] = snap.box;
    both(`M${x1} ${y1}H${x2}V${y2}H${x1}Z`, colour(snap));
    if (snap.yaw_deg != null) both(arrow(snap), colour(snap));
    const text = `${snap.class} ${snap.score.toFixed(2)}`, letters = 13 * pixel;
    const [wide, high] = [text.length * 0.58 * letters + 8 * pixel, 1.45 * letters];
    const x = Math.max(0, Math.min(x1, width - wide)), y = y1 >= high ? y1 - high : Math.min(y2, height - high);
    shape("rect", { x, y, width: wide, height: high, fill: colour(snap) });
    shape("text", { x: x + 4 * pixel, y: y + 1.07 * letters, "font-size": letters }, text);
  }
}

/** From the middle of a box along its yaw. */
function arrow({ box: [x1, y1, x2, y2], yaw_deg }) {
  const [x, y] = [(x1 + x2) / 2, (y1 + y2) / 2], yaw = (yaw_deg * Math.PI) / 180;
  const long = 0.45 * Math.min(x2 - x1, y2 - y1);
  const at = (angle, length, [fromX, fromY]) => [fromX + length * Math.cos(angle), fromY + length * Math.sin(angle)];
  const tip = at(yaw, long, [x, y]);
  const [left, right] = [-2.6, 2.6].map((turn) => at(yaw + turn, 0.35 * long, tip));
  return `M${at(yaw, -long, [x, y])}L${tip}M${left}L${tip}L${right}`;
}

// The kernels' check.

let checking = null;

async function checkKernels() {
  if (checking) return checking.abort();
  checking = new AbortController();
  const { signal } = checking;
  const operations = new Map();
  const button = $("check"), progress = $("progress"), verdict = $("verdict");
  button.textContent = "Stop";
  verdict.className = "";
  verdict.textContent = "Opening the GPU…";
  $("operations").replaceChildren();
  progress.hidden = false;
  progress.removeAttribute("value");
  let runs = 0, failures = 0, on;
  try {
    for await (const step of check()) {
      const { operation, case: name, kernels, done, adapter } = step;
      on = adapter;
      progress.value = done;
      verdict.textContent = `${Math.floor(100 * done)} %: ${operation}, ${name}`;
      if (!operations.has(operation)) operations.set(operation, new Operation(operation));
      for (const result of kernels) failures += operations.get(operation).add(name, result) ? 0 : 1;
      runs += kernels.length;
      if (signal.aborted) break;
    }
    verdict.className = failures ? "failed" : "ok";
    const stopped = signal.aborted ? "Stopped. " : "";
    const said = failures ? `${failures} of ${runs} runs are wrong` : `All ${runs} runs are within their bounds`;
    verdict.textContent = `${stopped}${said}, on ${on}.`;
  } catch (error) {
    verdict.className = "failed";
    verdict.textContent = error.message;
  } finally {
    checking = null;
    progress.hidden = true;
    button.textContent = "Check every kernel";
  }
}

/** An operation's line, and its cases below it. */
class Operation {
  #worst = 0;
  #runs = 0;
  #failures = 0;
  /** The last one's name, which stands once for all its kernels. */
  #case;

  constructor(name) {
    this.runs = element("span", { className: "soft" });
    this.meter = element("meter", { min: 0, max: 1, high: 1, value: 0 });
    this.share = element("span", { className: "number" });
    this.verdict = element("span");
    this.rows = element("tbody");
    const head = element("tr", {}, ...["case", "kernel", "in", "error / bound"].map((text) => element("th", {}, text)));
    head.lastChild.className = "number";
    $("operations").append(element("details", {},
      element("summary", {}, element("span", {}, name), this.runs, this.meter, this.share, this.verdict),
      element("div", {}, element("table", {}, element("thead", {}, head), this.rows))));
  }

  /** Adds what a kernel made of a case; returns whether it is right. */
  add(name, { kernel, precision, share, failures, overflows }) {
    const isRight = failures.length === 0;
    this.#runs += 1;
    this.#failures += isRight ? 0 : 1;
    this.#worst = Math.max(this.#worst, share ?? Infinity);
    const remarks = [...failures, ...overflows].map((text) => element("small", { className: isRight ? "" : "failed" }, text));
    const isFirst = name !== this.#case;
    this.#case = name;
    this.rows.append(element("tr", { className: isFirst ? "first" : "" },
      element("td", {}, isFirst ? name : "", ...remarks),
      element("td", {}, kernel.split("/").pop()),
      element("td", {}, precision),
      element("td", { className: isRight ? "number" : "number failed" }, share == null ? "∞" : share.toFixed(3))));
    this.runs.textContent = `${this.#runs} runs`;
    this.meter.value = this.#worst;
    this.share.textContent = Number.isFinite(this.#worst) ? this.#worst.toFixed(3) : "∞";
    this.verdict.className = this.#failures ? "failed" : "ok";
    this.verdict.textContent = this.#failures ? `${this.#failures} wrong` : "ok";
    return isRight;
  }
}

// What the visitor does.

function press(name) {
  for (const button of $("samples").querySelectorAll("button")) {
    button.setAttribute("aria-pressed", button.name === name);
  }
}

for (const name of SAMPLES) {
  const button = element("button", { type: "button", name },
    element("img", { src: `samples/${name}.png`, alt: "", loading: "lazy" }), name.replace("_", " "));
  button.onclick = () => {
    const opened = open(`samples/${name}.png`, "paper");
    press(name);
    return opened;
  };
  $("samples").append(element("li", {}, button));
}

$("choose").onclick = () => $("file").click();
$("file").onchange = ({ target }) => {
  if (target.files[0]) open(target.files[0]);
  target.value = "";
};
$("camera").onclick = () => (stream ? stopCamera() : openCamera());
$("check").onclick = checkKernels;
settings.onsubmit = (event) => event.preventDefault();
settings.onchange = ({ target }) => {
  isChosen ||= target.name !== "weights";
  $("millimetres").hidden = settings.elements.scale.value !== "stated";
  load();
  if (shown && !stream) look(shown);
};
document.ondragover = (event) => {
  event.preventDefault();
  $("stage").classList.add("over");
};
document.ondragleave = () => $("stage").classList.remove("over");
document.ondrop = (event) => {
  event.preventDefault();
  $("stage").classList.remove("over");
  const [file] = event.dataTransfer.files;
  if (file) open(file);
};
new ResizeObserver(draw).observe($("stage"));

load();
$("samples").querySelector("button").click();
