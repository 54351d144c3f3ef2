"""What the detector makes of images in other encodings, and what the node says of those that it cannot read."""

import numpy as np
from conftest import image, rows


def test_every_encoding_is_answered(start, peer, detector, mixed):
    start()
    gray = mixed[..., 1:2]
    alpha = np.full_like(gray, 77)
    wide = np.repeat(mixed.astype(np.uint16) * 257, 1, axis=2)
    uyvy = np.concatenate([np.full_like(gray, 128), gray], axis=2)
    cases = [
        (image(mixed, "rgb8"), mixed, "RGB"),
        (image(mixed, "rgb8", step=3011), mixed, "RGB"),
        (image(mixed[..., ::-1], "bgr8"), mixed, "RGB"),
        (image(np.concatenate([mixed, alpha], axis=2), "rgba8"), mixed, "RGB"),
        (image(np.concatenate([mixed[..., ::-1], alpha], axis=2), "bgra8"), mixed, "RGB"),
        (image(gray, "mono8"), gray, "GRAY"),
        (image(wide[..., 1:2], "mono16"), gray, "GRAY"),
        (image(wide[..., 1:2].astype(">u2"), "mono16", is_bigendian=1), gray, "GRAY"),
        (image(gray, "bayer_rggb8"), gray, "BAYER_RGGB"),
        (image(uyvy[..., ::-1], "yuyv"), np.ascontiguousarray(uyvy[..., ::-1]), "YUYV"),
        (image(uyvy, "yuv422"), np.ascontiguousarray(uyvy[..., ::-1]), "YUYV"),
    ]
    for message, pixels, order in cases:
        want = detector(np.ascontiguousarray(pixels), order=order)
        got = rows(peer.answer(message))
        boxes = [(snap.class_name, snap.score, (x1 + x2) / 2, y2 - y1)
                 for snap in want for x1, y1, x2, y2 in [snap.box]]  # fmt: skip
        assert [(row[0], row[1], row[2][0], row[2][3]) for row in got] == boxes, message.encoding
        peer.detections.clear()


def test_an_unknown_encoding_is_told_and_the_next_image_answered(start, peer, mixed):
    node = start()
    unknown = image(np.zeros((8, 8), np.float32), "32FC1")
    level, message, values = peer.report(lambda level, message, values: int(values["failed"]) > 3, sending=unknown)
    assert (level, values["last error"]) == (b"\x02", message)
    assert message.startswith("encoding: expected mono8") and message.endswith("got `32FC1`")
    # Not told for each image.
    assert 0 < node.log().count("got `32FC1`") < int(values["failed"])
    assert len(peer.answer(image(mixed, "rgb8")).detections) == 3
    level, _, values = peer.report(lambda level, *_: level == b"\x00", sending=image(mixed, "rgb8"))
    assert values["last error"] == message
    assert node.end() == 0
