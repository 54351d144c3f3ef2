/* smr-gpu: finds snap joints in pictures of a GelSight-like tactile sensor.
 *
 * A detector may be used from several threads at a time; whoever frees it must be the last to use it. What
 * smr_last_error returns belongs to the calling thread and is valid until its next call that fails. No function
 * ends the process or lets an exception or a panic out. After fork() open a new detector.
 *
 * This file is generated from bindings/c/src/lib.rs.
 */

#ifndef SMR_GPU_H
#define SMR_GPU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// Version of this interface: a program made for another one must be compiled anew.
#define SMR_ABI 1

// What came of a call.
typedef enum {
  // All is well.
  SMR_STATUS_OK = 0,
  // An argument cannot be: a null pointer, a format or number out of its range, text that is not UTF-8.
  SMR_STATUS_ARGUMENT = 1,
  // The weights, or the sensor's file, are not there or damaged.
  SMR_STATUS_FILE = 2,
  // There is no such device, it cannot be opened, or it was lost.
  SMR_STATUS_DEVICE = 3,
  // The frame is not what it says, or cannot be the sensor's.
  SMR_STATUS_FRAME = 4,
  // The device did not finish in time.
  SMR_STATUS_TIMEOUT = 5,
  // A fault of this library.
  SMR_STATUS_INTERNAL = 6,
} SmrStatus;

// How the scale is known.
typedef enum {
  // The caller said it.
  SMR_ORIGIN_STATED = 0,
  // The sensor says it.
  SMR_ORIGIN_SENSOR = 1,
  // Nobody says it: 40 mm along the gel's shorter side.
  SMR_ORIGIN_ASSUMED = 2,
} SmrOrigin;

// Whether something touches the gel.
typedef enum {
  // Nobody looked.
  SMR_CONTACT_UNKNOWN = 0,
  // Nothing does, and the network did not run.
  SMR_CONTACT_NONE = 1,
  // Something does.
  SMR_CONTACT_SOME = 2,
} SmrContact;

// How a frame's pixels lie in memory.
typedef enum {
  // Red, green, blue; a byte each.
  SMR_FORMAT_RGB8 = 0,
  // Blue, green, red, as OpenCV has it.
  SMR_FORMAT_BGR8 = 1,
  // Red, green, blue, and a byte that is ignored.
  SMR_FORMAT_RGBA8 = 2,
  // Blue, green, red, and a byte that is ignored.
  SMR_FORMAT_BGRA8 = 3,
  // Grey.
  SMR_FORMAT_GRAY8 = 4,
  // Grey of 16 bits, the low byte first; 65535 is white.
  SMR_FORMAT_GRAY16 = 5,
  // Behind a Bayer filter: the first row's first two pixels, then the second row's.
  SMR_FORMAT_BAYER_RGGB8 = 6,
  // The same in another order.
  SMR_FORMAT_BAYER_BGGR8 = 7,
  // The same in another order.
  SMR_FORMAT_BAYER_GRBG8 = 8,
  // The same in another order.
  SMR_FORMAT_BAYER_GBRG8 = 9,
  // YUV 4:2:2, also called YUY2.
  SMR_FORMAT_YUYV = 10,
  // YUV 4:2:0: all luma, then pairs of colour differences.
  SMR_FORMAT_NV12 = 11,
} SmrFormat;

// A detector.
typedef struct SmrDetector SmrDetector;

// How to open a detector. Begin with smr_options_default.
typedef struct {
  // SMR_ABI.
  uint32_t abi;
  // "small", "large", a name, or a weight file. UTF-8.
  const char *weights;
  // "auto", "cpu", "gpu", an adapter's index or part of its name.
  const char *device;
  // "paper", "gelsight-mini", "digit" or a sensor file; null for none.
  const char *sensor;
  // Millimetres of gel for a pixel of the frames; 0 for what the sensor says.
  float mm_per_pixel;
  // A detection's score must be above this; 0 to 1.
  float score;
  // At most so many detections a frame; 1 to 100.
  uint32_t max_detections;
  // Leave nothing out, whatever the frame shows.
  bool exact;
} SmrOptions;

// A frame in memory, which need not outlive the call.
typedef struct {
  // Its pixels, row by row from the top.
  const uint8_t *data;
  // How many bytes there are.
  size_t size;
  // Columns.
  uint32_t width;
  // Rows.
  uint32_t height;
  // Bytes from the start of a row to that of the next; 0 where rows follow one another.
  size_t stride;
  // An SmrFormat.
  uint32_t format;
} SmrFrame;

// A snap. What the weights do not tell is NaN.
typedef struct {
  // Its class, for smr_class_name.
  uint32_t class_index;
  // 0 to 1.
  float score;
  // Corners x1, y1, x2, y2 in pixels of the frame.
  float bbox[4];
  // Centre on the gel, from the gel's middle, x right, y down; millimetres.
  float center_mm[2];
  // Standard deviation of that.
  float center_std_mm[2];
  // Direction in degrees, 0 to the right, 90 down; NaN for a class without.
  float yaw_deg;
  // Standard deviation of that.
  float yaw_std_deg;
  // Probability that the frame's edge does not cut it.
  float whole;
} SmrSnap;

// What a frame shows. Free it by smr_detections_free.
typedef struct {
  // The snaps, best first; null where there are none.
  SmrSnap *snaps;
  // How many.
  size_t count;
  // Millimetres of gel for a pixel of the frame.
  float mm_per_pixel;
  // How that is known.
  SmrOrigin scale_from;
  // Whether something touches the gel.
  SmrContact contact;
  // Time from frame to detections, in milliseconds.
  double wall_ms;
} SmrDetections;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Options that are what the program does unasked, but with the small network, which is in the library: any device,
// no sensor.
SmrOptions smr_options_default(void);

// Opens a detector, which takes up to some seconds, and writes it to `detector`; null if it fails.
//
// # Safety
// `options` points to options whose texts are null or NUL-terminated; `detector` to a pointer.
SmrStatus smr_detector_open(const SmrOptions *options, SmrDetector **detector);

// Frees a detector; null is nothing.
//
// # Safety
// `detector` is null or came from smr_detector_open, was not freed, and no thread uses it any more.
void smr_detector_free(SmrDetector *detector);

// Finds the snaps in a frame and writes them to `detections`; none if it fails.
//
// # Safety
// `detector` came from smr_detector_open; `frame` points to a frame whose `data` has `size` bytes;
// `detections` to what may be written over.
SmrStatus smr_detect(const SmrDetector *detector, const SmrFrame *frame, SmrDetections *detections);

// Frees what smr_detect wrote, and leaves none there; null is nothing.
//
// # Safety
// `detections` is null or points to what smr_detect wrote.
void smr_detections_free(SmrDetections *detections);

// How many classes the weights know; 0 for null.
//
// # Safety
// `detector` is null or came from smr_detector_open.
uint32_t smr_class_count(const SmrDetector *detector);

// A class's name, which lives as long as the detector; null if there is none of this index.
//
// # Safety
// `detector` is null or came from smr_detector_open.
const char *smr_class_name(const SmrDetector *detector, uint32_t class_index);

// What the network runs on, which lives as long as the detector; null for null.
//
// # Safety
// `detector` is null or came from smr_detector_open.
const char *smr_device_name(const SmrDetector *detector);

// What the last call on this thread that failed says; empty if none did.
const char *smr_last_error(void);

// This library's version.
const char *smr_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SMR_GPU_H */
