"""Batches, streams, threads, asyncio and processes."""

import asyncio
import os
import sys
import threading
import time

import numpy as np
import pytest
from conftest import DEVICE, SAMPLES, same
from PIL import Image

import smr_gpu
from smr_gpu import errors


@pytest.fixture(scope="module")
def pictures():
    return [np.array(Image.open(path).convert("RGB")) for path in SAMPLES]


@pytest.fixture(scope="module")
def alone(detector, pictures):
    return [detector(picture) for picture in pictures]


def all_same(found, want):
    return len(found) == len(want) and all(same(one, other) for one, other in zip(found, want))


def test_batches_equal_single_pictures(detector, pictures, alone):
    assert all_same(detector(pictures), alone)
    assert all_same(detector(np.stack(pictures)), alone)
    assert all_same(detector(SAMPLES), alone)
    assert detector([]) == []
    with pytest.raises(errors.ParamError):
        detector([pictures[0], np.zeros(3)])


def test_a_stream_keeps_the_order_and_copies_what_it_takes(detector, pictures, alone):
    buffer = np.empty_like(pictures[0])

    def camera():
        for picture in pictures:
            buffer[:] = picture
            yield buffer

    assert all_same(list(detector.stream(camera())), alone)


def test_a_stream_takes_few_frames_ahead(detector, pictures):
    taken = 0

    def endless():
        nonlocal taken
        while True:
            taken += 1
            yield pictures[taken % len(pictures)]

    stream = detector.stream(endless())
    for given in range(1, 6):
        next(stream)
        # Two in flight, on a GPU of two each, and those whose results wait.
        assert taken <= given + 6


def test_a_stream_ends_with_the_error_behind_the_results(detector, pictures, alone):
    def breaks():
        yield pictures[0]
        yield pictures[1]
        raise OSError("the cable")

    stream = detector.stream(breaks())
    assert all_same([next(stream), next(stream)], alone[:2])
    with pytest.raises(OSError, match="the cable"):
        next(stream)
    assert list(stream) == []
    stream = detector.stream([pictures[0], np.zeros((4, 4))])
    assert same(next(stream), alone[0])
    with pytest.raises(errors.ParamError, match="float64"):
        next(stream)
    with pytest.raises(TypeError):
        detector.stream(3)


def test_a_camera_reuses_what_did_not_change(detector, pictures, alone):
    found = list(detector.stream([pictures[0]] * 3 + [pictures[1]], reuse=True))
    assert [each.reused for each in found] == [False, True, True, False]
    assert all_same(found, [alone[0]] * 3 + [alone[1]])


def test_asyncio_goes_on_while_it_computes(detector, pictures, alone):
    async def main():
        return await asyncio.gather(*(detector.detect_async(picture) for picture in pictures))

    assert all_same(asyncio.run(main()), alone)

    async def refused():
        await detector.detect_async(np.zeros(3))

    with pytest.raises(errors.ParamError):
        asyncio.run(refused())


def test_other_threads_run_while_it_computes(detector, mixed):
    count, done = 0, False

    def counter():
        nonlocal count
        while not done:
            count += 1
            time.sleep(0)  # lets go of the interpreter's lock

    thread = threading.Thread(target=counter)
    interval = sys.getswitchinterval()
    # With a switch interval of an hour a thread runs only where another lets go of that lock.
    sys.setswitchinterval(3600)
    try:
        thread.start()
        before = count
        for _ in range(20):
            detector(mixed)
        after = count
    finally:
        done = True
        sys.setswitchinterval(interval)
        thread.join()
    assert after > before


def test_threads_share_a_detector(detector, pictures, alone):
    wrong = []

    def look(first):
        for at in range(first, first + 2 * len(pictures)):
            at %= len(pictures)
            if not same(detector(pictures[at]), alone[at]):
                wrong.append(at)

    threads = [threading.Thread(target=look, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def in_child(act):
    """What `act` returns in a forked process, as text."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            text = act()
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(write, text.encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as answer:
        text = answer.read()
    os.waitpid(pid, 0)
    return text


def test_a_forked_process_is_told(detector, mixed):
    stream = detector.stream([mixed] * 8)
    next(stream)
    for act in (
        lambda: detector(mixed),
        lambda: next(stream),
        lambda: detector.adapter,
        lambda: smr_gpu.Detector(device=DEVICE),
    ):
        message = in_child(act)
        assert message.startswith("ForkError: process ") and f"built the detector, {os.getpid()}" in message
    # What it leaves alone, here too.
    assert in_child(lambda: f"{len(detector.classes)} classes") == "2 classes"

    def drops():
        nonlocal stream
        stream = None
        return "dropped"

    assert in_child(drops) == "dropped"
    assert len(list(stream)) == 7
