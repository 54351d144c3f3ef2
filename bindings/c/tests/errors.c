/* Calls that cannot be: each says why, and nothing was written. Then four threads with one detector. */
#include <assert.h>
#include <pthread.h>
#include <smr_gpu.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void told(SmrStatus status) {
    assert(status != SMR_STATUS_OK);
    printf("%d %s\n", (int)status, smr_last_error());
}

static void refused(const SmrOptions *options) {
    SmrDetector *detector = (SmrDetector *)1;
    told(smr_detector_open(options, &detector));
    assert(detector == NULL);
}

static void unseen(const SmrDetector *detector, const SmrFrame *frame) {
    SmrDetections found;
    memset(&found, 0xaa, sizeof found);
    told(smr_detect(detector, frame, &found));
    assert(found.snaps == NULL && found.count == 0);
    smr_detections_free(&found);
}

struct job {
    const SmrDetector *detector;
    SmrFrame frame;
};

static void *look(void *argument) {
    const struct job *job = argument;
    for (int i = 0; i < 3; i++) {
        SmrDetections found;
        assert(smr_detect(job->detector, &job->frame, &found) == SMR_STATUS_OK);
        /* Grey all over: nothing touches. */
        assert(found.count == 0 && found.contact == SMR_CONTACT_NONE);
        assert(found.scale_from == SMR_ORIGIN_STATED);
        smr_detections_free(&found);
    }
    return NULL;
}

int main(void) {
    assert(strlen(smr_version()) > 0 && smr_last_error()[0] == '\0');
    SmrOptions options = smr_options_default();
    refused(NULL);
    told(smr_detector_open(&options, NULL));
    SmrOptions wrong = options;
    wrong.abi = 9;
    refused(&wrong);
    wrong = options;
    wrong.weights = "nowhere";
    refused(&wrong);
    wrong = options;
    wrong.device = "cpu";
    wrong.score = 2;
    refused(&wrong);
    wrong = options;
    wrong.sensor = "nowhere.json";
    refused(&wrong);

    options.device = "cpu";
    options.mm_per_pixel = 0.1f;
    SmrDetector *detector;
    assert(smr_detector_open(&options, &detector) == SMR_STATUS_OK);
    assert(smr_class_count(detector) == 2 && strcmp(smr_class_name(detector, 0), "A") == 0);
    assert(smr_class_name(detector, 2) == NULL && strlen(smr_device_name(detector)) > 0);

    size_t size = 400 * 400 * 3;
    unsigned char *grey = malloc(size);
    assert(grey != NULL);
    memset(grey, 128, size);
    const SmrFrame frame = {.data = grey, .size = size, .width = 400, .height = 400, .format = SMR_FORMAT_RGB8};
    unseen(NULL, &frame);
    unseen(detector, NULL);
    SmrFrame broken = frame;
    broken.data = NULL;
    unseen(detector, &broken);
    broken = frame;
    broken.format = 99;
    unseen(detector, &broken);
    broken = frame;
    broken.size = size - 1;
    unseen(detector, &broken);
    broken = frame;
    broken.stride = 3;
    unseen(detector, &broken);
    broken = frame;
    broken.width = 0;
    unseen(detector, &broken);
    fflush(stdout);

    struct job job = {detector, frame};
    pthread_t threads[4];
    for (int i = 0; i < 4; i++)
        assert(pthread_create(&threads[i], NULL, look, &job) == 0);
    for (int i = 0; i < 4; i++)
        assert(pthread_join(threads[i], NULL) == 0);
    smr_detector_free(detector);
    smr_detector_free(NULL);
    smr_detections_free(NULL);
    free(grey);
    return 0;
}
