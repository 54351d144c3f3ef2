/* Finds the snaps in a picture: detect PICTURE.ppm [MM_PER_PIXEL [DEVICE]] */
#include <smr_gpu.h>
#include <stdio.h>
#include <stdlib.h>

/* Reads a binary PPM of 8 bits; its pixels, or NULL. */
static unsigned char *read_ppm(const char *path, SmrFrame *frame) {
    FILE *file = fopen(path, "rb");
    if (file == NULL)
        return NULL;
    unsigned width, height;
    unsigned char *pixels = NULL;
    /* One white space follows the largest level. */
    if (fscanf(file, "P6 %u %u 255%*c", &width, &height) == 2 && width - 1 < 8192 && height - 1 < 8192) {
        size_t size = (size_t)width * height * 3;
        pixels = malloc(size);
        if (pixels != NULL && fread(pixels, 1, size, file) != size) {
            free(pixels);
            pixels = NULL;
        }
        *frame = (SmrFrame){.data = pixels, .size = size, .width = width, .height = height, .format = SMR_FORMAT_RGB8};
    }
    fclose(file);
    return pixels;
}

int main(int argc, char **argv) {
    if (argc < 2) {
        fprintf(stderr, "usage: %s PICTURE.ppm [MM_PER_PIXEL [DEVICE]]\n", argv[0]);
        return 2;
    }
    SmrFrame frame;
    unsigned char *pixels = read_ppm(argv[1], &frame);
    if (pixels == NULL) {
        fprintf(stderr, "%s: expected a binary PPM of 8 bits\n", argv[1]);
        return 1;
    }
    SmrOptions options = smr_options_default();
    if (argc > 2)
        options.mm_per_pixel = strtof(argv[2], NULL);
    if (argc > 3)
        options.device = argv[3];
    SmrDetector *detector;
    SmrDetections found;
    int failed = smr_detector_open(&options, &detector) != SMR_STATUS_OK;
    if (!failed && (failed = smr_detect(detector, &frame, &found) != SMR_STATUS_OK) == 0) {
        for (size_t i = 0; i < found.count; i++) {
            const SmrSnap *snap = &found.snaps[i];
            printf("%s %.4f  %.2f %.2f %.2f %.2f px  %.3f %.3f mm", smr_class_name(detector, snap->class_index), snap->score,
                   snap->bbox[0], snap->bbox[1], snap->bbox[2], snap->bbox[3], snap->center_mm[0], snap->center_mm[1]);
            /* Only a NaN differs from itself. */
            if (snap->yaw_deg == snap->yaw_deg)
                printf("  %.1f deg", snap->yaw_deg);
            printf("\n");
        }
        smr_detections_free(&found);
    }
    if (failed)
        fprintf(stderr, "%s\n", smr_last_error());
    smr_detector_free(detector);
    free(pixels);
    return failed;
}
