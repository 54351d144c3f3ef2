"""The thread that takes images: what waits, and what is dropped."""

import threading

from smr_gpu_ros.worker import Worker


class Held:
    """A worker whose work waits until it may go on."""

    def __init__(self, room):
        self.done, self.begun, self.may = [], threading.Semaphore(0), threading.Semaphore(0)
        self.worker = Worker(self.work, room)

    def work(self, job):
        self.begun.release()
        self.may.acquire()
        self.done.append(job)

    def end(self, count):
        """Lets as many jobs through."""
        for _ in range(count):
            self.may.release()
            self.begun.acquire()


def held(room):
    held = Held(room)
    held.worker.put("first")
    held.begun.acquire()
    return held


def test_the_oldest_is_dropped_while_a_job_runs():
    work = held(room=2)
    for job in range(5):
        work.worker.put(job)
    assert work.worker.dropped == 3
    work.end(2)
    assert work.done == ["first", 3]
    work.may.release()
    work.worker.stop()
    assert work.done == ["first", 3, 4]


def test_less_room_drops_at_once():
    work = held(room=3)
    for job in range(3):
        work.worker.put(job)
    assert work.worker.dropped == 0
    work.worker.set_room(1)
    assert work.worker.dropped == 2
    work.end(1)
    work.may.release()
    work.worker.stop()
    assert work.done == ["first", 2]


def test_stopping_leaves_what_waits():
    work = held(room=3)
    work.worker.put("waits")
    stopping = threading.Thread(target=work.worker.stop)
    stopping.start()
    while not work.worker._stopped:
        pass
    work.may.release()
    stopping.join()
    assert work.done == ["first"]
