"""The program by its entry point, Ctrl-C, and other processes."""

import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import program

import scenesplat


def test_the_program_runs(tmp_path):
    assert program("-V").stdout.strip() == f"scenesplat {scenesplat.__version__}"
    assert "commit: " in program("--version").stdout
    wrong = program("segment")
    assert wrong.returncode == 2 and "Usage" in wrong.stderr
    missing = program("inspect", tmp_path / "none.ply")
    assert missing.returncode == 1 and missing.stderr.startswith("error: ")


def test_the_program_starts_itself_for_many_scenes(demo, tmp_path):
    (tmp_path / "list").write_text(f"{demo / 'room.ply'}\n")
    done = program("features", "--manifest", tmp_path / "list", "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "out").rglob("features.npy"))


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_stops_a_call(demo):
    code = (
        "import scenesplat, signal, sys\n"
        # A shell that starts its jobs in the background has them ignore the signal.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"scene = scenesplat.Scene.open({str(demo / 'room.ply')!r})\n"
        "network = scenesplat.Network.load(exact=True, setting='tta=12')\n"
        "print('ready', flush=True)\n"
        "try:\n"
        "    scenesplat.segment(scene, network)\n"
        "except KeyboardInterrupt:\n"
        "    print('stopped', flush=True)\n"
        "print(scenesplat.segment(scene).labels.size, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "ready\n"
        time.sleep(0.5)
        began = time.monotonic()
        child.send_signal(signal.SIGINT)
        assert child.stdout.readline() == "stopped\n"
        assert time.monotonic() - began < 20
        # The interpreter goes on, and so does the package.
        assert int(child.stdout.readline()) > 0
    assert child.returncode == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_has_threads_of_its_own(room):
    code = (
        "import os, numpy as np, scenesplat\n"
        "points = np.random.default_rng(1).normal(size=(1000, 3))\n"
        "scenesplat.kernels.knn(points, 3)\n"
        "pid = os.fork()\n"
        "if pid == 0:\n"
        "    scenesplat.kernels.knn(points, 3)\n"
        "    os._exit(7)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7\n"
    )
    done = subprocess.run([sys.executable, "-c", code], timeout=60, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_number_of_threads_changes_no_bit(room, network):
    before, one = scenesplat.num_threads(), None
    try:
        scenesplat.set_num_threads(1)
        one = scenesplat.segment(room, network).labels
        scenesplat.set_num_threads(3)
        assert scenesplat.num_threads() == 3
        assert scenesplat.segment(room, network).labels.tobytes() == one.tobytes()
        with pytest.raises(ValueError, match="threads: 0"):
            scenesplat.set_num_threads(0)
    finally:
        scenesplat.set_num_threads(before)
