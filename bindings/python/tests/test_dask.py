"""examples/with_dask.py: a folder on two workers of which one is killed."""

import os
import shutil
import signal

import pytest
from conftest import DEVICE, SAMPLES, same
from distributed import Client, LocalCluster
from with_dask import find

import smr_gpu


@pytest.fixture
def client():
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        yield client


def test_a_killed_worker_loses_no_picture_and_none_comes_twice(client, tmp_path, detector):
    files = [tmp_path / f"{at:02}.png" for at in range(30)]
    for at, file in enumerate(files):
        shutil.copy(SAMPLES[at % len(SAMPLES)], file)
    files[7].write_text("no picture")

    found, running = [], client.run(os.getpid)
    assert len(running) == 2
    for result in find(client, files, device=DEVICE):
        found.append(result)
        if len(found) == 5:
            # It has work: thirty tasks were given to two.
            worker, process = next(iter(running.items()))
            assert client.processing()[worker]
            os.kill(process, signal.SIGKILL)

    assert len(found) == len(files)
    assert isinstance(found[7], smr_gpu.Error) and str(files[7]) in str(found[7])
    assert all(same(one, detector(file)) for at, (one, file) in enumerate(zip(found, files)) if at != 7)
    assert sum(len(one) for at, one in enumerate(found) if at != 7) > len(files)
    assert process not in client.run(os.getpid).values()
