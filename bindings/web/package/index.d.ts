/** A part of a picture, in pixels. */
export interface Rectangle {
  x: number;
  y: number;
  width: number;
  height: number;
}

/** One snap. Names, units and axes are those of `smr-gpu detect --json`. */
export interface Detection {
  /** Name of the class. */
  class: string;
  /** Its place in {@link Detector.classes}. */
  class_index: number;
  /** Confidence from 0 to 1. */
  score: number;
  /** Corners x1, y1, x2, y2 in pixels of the picture; pixel i covers [i, i + 1]. */
  box: [number, number, number, number];
  /** Centre of the box on the gel in millimetres from the gel's middle: x right, y down. */
  center_mm: [number, number];
  /** Standard deviations of that centre; null where the weights do not tell. */
  center_std_mm: [number, number] | null;
  /** Direction from a hook's root to its tip in degrees, 0 along x, 90 along y (down); null for a class without one. */
  yaw_deg: number | null;
  /** Standard deviation of that direction; null where the weights do not tell. */
  yaw_std_deg: number | null;
  /** Probability that the picture's edge does not cut the snap; null where the weights do not tell. */
  whole: number | null;
}

/** What a picture holds, and what finding it took. */
export interface Detections {
  width: number;
  height: number;
  /** The part that shows the gel, from whose middle positions are. */
  gel: Rectangle;
  gel_assumed: boolean;
  mm_per_pixel: number;
  scale_from: "stated" | "sensor" | "label" | "assumed";
  /** What was assumed of scale and gel, in a line; null where all was stated. */
  assumption: string | null;
  /** By falling score. */
  detections: Detection[];
  /** Whether something touches the gel; null where nobody looked. */
  contact: boolean | null;
  /** The parts that the network looked at; null for the whole picture. */
  regions: Rectangle[] | null;
  /** What was left out, and why. */
  left_out: string[];
  /** Milliseconds. Without timestamps on the GPU there is no stage but `frame`, the host's own part. */
  timings_ms: { stages: { stage: string; ms: number }[]; total: number };
  precision: "f32" | "f16";
  /** Stands for the choice of kernels: equal choices on one device give equal bits. */
  kernels: string;
}

/** The fields of a sensor file: docs/reference/sensor-file.md. */
export interface SensorFile {
  name: string;
  [field: string]: unknown;
}

export interface Options {
  /** A weight file (safetensors): its URL, relative to the page's, or its bytes. */
  weights: string | URL | ArrayBuffer | ArrayBufferView;
  /** The sensor that takes the pictures, built in or described. */
  sensor?: "paper" | "gelsight-mini" | "digit" | "plain" | SensorFile;
  /** Millimetres of gel for a pixel of the pictures that come, whatever their size. */
  mmPerPixel?: number;
  /** The part of each picture that shows the gel. */
  gel?: Rectangle;
  /** Refuse pictures whose scale would be assumed. */
  strictScale?: boolean;
  /** Longer side of the network's input in pixels, a multiple of 32. */
  inputSize?: number;
  /** What may be left out of a picture that does not need it; [] for nothing. */
  leaveOut?: ("contact" | "regions" | "proposals" | "scales")[];
  /** Least score, from 0 to 1; 0.5 by default. */
  score?: number;
  /** Of two detections of a class that overlap by more than this, the lower goes; 0.5 by default. */
  iou?: number;
  /** 1 to 100. */
  maxDetections?: number;
  /** Names of the wanted classes; all by default. */
  classes?: string[];
  /** How the GPU stores maps and weights; f32 by default. */
  precision?: "f32" | "f16";
  /** Longest wait for a picture in seconds; 120 by default. */
  timeout?: number;
  /** Hears how many bytes of the weights have come, and of how many, where that is known. */
  onProgress?: (loaded: number, total: number | null) => void;
}

/** What an error is about. */
export type ErrorKind =
  /** The browser has no WebGPU, or the page came neither by https nor from localhost. */
  | "NoWebGpu"
  /** WebGPU is there, and no GPU. */
  | "NoAdapter"
  /** Nothing is at the URL of the weights. */
  | "NoWeights"
  /** What is there is damaged, or does not fit. */
  | "Weights"
  /** The browser cannot show the picture, or it is empty. */
  | "Picture"
  /** An option, an operation or a case that there is not. */
  | "Param"
  | "Sensor"
  | "Scale"
  /** The GPU: too small, gone, late, out of memory, or of another mind than the shaders. */
  | "Capacity"
  | "Device"
  | "DeviceLost"
  | "Timeout"
  | "Driver"
  | "Shader"
  /** Numbers ran over. */
  | "NotFinite"
  | "Overflow"
  | "Tensor"
  /** It was closed. */
  | "Closed"
  /** A fault of the package. */
  | "Internal";

export class SmrGpuError extends Error {
  readonly kind: ErrorKind;
}

/** Finds snaps in pictures, in a worker of its own. */
export class Detector {
  private constructor();
  /** Opens the GPU, compiles the shaders and uploads the weights. */
  static load(options: Options): Promise<Detector>;
  /**
   * Finds the snaps in a picture, or in the frame that a video shows. An ImageBitmap stays the caller's. A file's
   * numbers are taken as they are, without its colour profile; what is transparent counts as black.
   */
  detect(source: ImageBitmapSource): Promise<Detections>;
  /** Names of the classes. */
  readonly classes: string[];
  /** The GPU, as far as the browser says. */
  readonly adapter: string;
  /** What went otherwise than the options say. */
  readonly remarks: string[];
  /** Gives the GPU's memory back. */
  close(): void;
}

/** What one kernel made of one case. */
export interface Checked {
  /** The operation's name and the kernel's own, `conv2d/direct`. */
  kernel: string;
  precision: "f32" | "f16";
  /** Largest error / bound, at most 1 in what passes; 0 where only equal bits will do; null where it has no end. */
  share: number | null;
  /** What is wrong, in words; empty where nothing is. */
  failures: string[];
  /** Where numbers overflowed that do not in f64. */
  overflows: string[];
}

/** A case of an operation, by each kernel that runs it here. */
export interface CheckStep {
  operation: string;
  case: string;
  kernels: Checked[];
  /** Share of what is to be checked that is behind, up to 1. */
  done: number;
  /** The GPU, as far as the browser says. */
  adapter: string;
}

/**
 * Holds every kernel of all operations, or of one, to its reference on this GPU, case by case. Leaving the loop
 * ends it.
 */
export function check(options?: { operation?: string }): AsyncGenerator<CheckStep, void, void>;
