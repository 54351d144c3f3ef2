"""A tiny run from labels to the program: it ends with weights, can be stopped, killed and resumed, and starts from others.

`SMR_GPU=smr-gpu python tests/test_fit.py`, where smr-gpu is the program
"""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import load_file
from smr_gpu_train.files import locked

SMR_GPU = os.environ["SMR_GPU"]
STEPS = 6
TINY = ["--steps", str(STEPS), "--area", "40000", "--threads", "1", "--checkpoint-minutes", "0"]


def call(*arguments: object, status: int = 0, room: int = resource.RLIM_INFINITY) -> str:
    """Stdout of a command that ends so, and of one that fails its one line of stderr; no file is longer than `room` bytes."""
    least = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))  # noqa: E731
    done = subprocess.run([sys.executable, "-m", "smr_gpu_train", *map(str, arguments)], capture_output=True, text=True, preexec_fn=least)
    assert done.returncode == status, f"{arguments}: {done.returncode}, expected {status}: {done.stdout}{done.stderr}"
    assert done.stderr.count("\n") == (status not in (0, 130)), done.stderr
    return done.stderr if status not in (0, 130) else done.stdout


def history(run: Path) -> list[dict]:
    """Its lines, without times."""
    lines = [json.loads(line) for line in (run / "history.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds_left"} for line in lines]


def classes(file: Path) -> list[str]:
    with safe_open(file, "pt") as saved:
        return json.loads(saved.metadata()["config"])["classes"]


class Fit(unittest.TestCase):
    root: Path
    data: Path
    whole: Path
    said: str

    @classmethod
    def setUpClass(cls) -> None:
        kept = tempfile.TemporaryDirectory()
        cls.addClassCleanup(kept.cleanup)
        cls.root = Path(kept.name)
        cls.data, cls.whole = cls.root / "data", cls.root / "whole"
        # Frames of 20 x 15 mm, so inputs of 192 x 128 pixels.
        subprocess.run([SMR_GPU, "simulate", "--out", cls.data, "--count", "12", "--seed", "7", "--sensor", "gelsight-mini"], check=True, capture_output=True)
        labels = cls.data / "annotations.json"
        coco = json.loads(labels.read_text())
        for category, name in zip(coco["categories"], ("bayonet", "Ball_Catch"), strict=True):
            category["name"] = name
        labels.write_text(json.dumps(coco))
        cls.said = call("fit", "--out", cls.whole, "--data", cls.data, "--val", cls.data, "--network", "small", *TINY)

    def test_a_run_ends_with_weights_that_the_program_runs(self) -> None:
        file = self.whole / "weights.safetensors"
        self.assertEqual(classes(file), ["bayonet", "Ball_Catch"])
        self.assertIn("12 pictures, ", self.said.splitlines()[0])
        self.assertIn("bayonet ", self.said.splitlines()[0])
        self.assertIn("(with a direction), Ball_Catch ", self.said.splitlines()[0])
        self.assertIn(f"val step {STEPS}", self.said)
        pictures = sorted((self.data / "images").glob("*.png"))[:2]
        done = subprocess.run([SMR_GPU, "detect", "--weights", file, "--json", "--conf", "0.05", "--sensor", "gelsight-mini", "--device", "cpu", *pictures], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        shown = subprocess.run([SMR_GPU, "eval", "--weights", file, "--data", self.data, "--device", "cpu"], capture_output=True, text=True)
        self.assertEqual(shown.returncode, 0, shown.stderr)
        self.assertIn("Ball_Catch", shown.stdout)

    def test_an_estimate_says_what_a_run_would_take_and_leaves_it_as_it_is(self) -> None:
        out = self.root / "estimated"
        begin = ["fit", "--out", out, "--data", self.data, "--network", "small", *TINY]
        said = json.loads(call(*begin, "--estimate").splitlines()[-1])
        self.assertEqual([*said], ["pictures", "without_snap", "snaps", "directed", "device", "threads", "seconds_per_step", "steps"])
        labels = json.loads((self.data / "annotations.json").read_text())["annotations"]
        self.assertEqual(said["snaps"], {"bayonet": sum(a["category_id"] == 1 for a in labels), "Ball_Catch": sum(a["category_id"] == 2 for a in labels)})
        self.assertEqual((said["pictures"], said["without_snap"]), (12, 12 - len({a["image_id"] for a in labels})))
        self.assertEqual((said["directed"], said["threads"], said["steps"]), (["bayonet"], 1, STEPS))
        self.assertGreater(said["seconds_per_step"], 0)
        self.assertEqual([file.name for file in out.iterdir()], ["cache"])
        call(*begin)
        self.assertEqual((out / "weights.safetensors").read_bytes(), (self.whole / "weights.safetensors").read_bytes())
        self.assertIn("holds a run", call(*begin, "--estimate", status=2))
        self.assertIn("leave out --resume", call("fit", "--out", out, "--resume", "--estimate", status=2))
        # What a run would refuse.
        self.assertIn("expected a weight file of SMR-Net", call("fit", "--out", self.root / "no", "--data", self.data, "--init", self.data / "annotations.json", *TINY, "--estimate", status=2))

    def test_a_split_is_evaluated_and_a_mix_is_learnt_from(self) -> None:
        out, mix = self.root / "split", self.root / "mix"
        subprocess.run([SMR_GPU, "simulate", "--out", mix, "--count", "6", "--seed", "8", "--sensor", "gelsight-mini"], check=True, capture_output=True)
        labels = mix / "annotations.json"
        coco = json.loads(labels.read_text())
        coco["categories"] = json.loads((self.data / "annotations.json").read_text())["categories"]
        labels.write_text(json.dumps(coco))
        begin = ["fit", "--out", out, "--data", self.data, "--mix", mix, "--mix-share", "0.3", "--split", "0.25", "--network", "small", *TINY, "--steps", "2"]
        self.assertEqual(json.loads(call(*begin, "--estimate").splitlines()[-1])["pictures"], 9 + 6)
        self.assertFalse((out / "split.json").exists())
        said = call(*begin)
        self.assertEqual(said.splitlines()[0].split(", ")[0], "9 pictures")
        self.assertTrue(said.splitlines()[1].startswith("mixed in, 30 % of all views: 6 pictures, "))
        self.assertIn("3 of 12 pictures held out", said)
        self.assertEqual(sorted(len(np.load(file)["sizes"]) for file in (out / "cache").iterdir()), [6, 9])
        split = out / "split.json"
        held = [row["file"] for row in json.loads(split.read_text())["held_out"]]
        self.assertEqual((len(held), {Path(file).parent for file in held}), (3, {self.data / "images"}))
        seen = history(out)[-1]["val"]
        call("evaluate", "--weights", out / "weights.safetensors", "--data", self.data, "--split", split, "--json", out / "figures.json")
        # A weight file holds numbers of 16 bits.
        of_file, of_run = json.loads((out / "figures.json").read_text())[str(self.data)], seen[str(self.data)]
        self.assertEqual([row["count"] for row in of_file.values()], [row["count"] for row in of_run.values()])
        labels = json.loads((self.data / "annotations.json").read_text())
        shown = {image["id"] for image in labels["images"] if str(self.data / image["file_name"]) in held or str(self.data / "images" / image["file_name"]) in held}
        self.assertEqual(of_file["all"]["count"], sum(a["image_id"] in shown for a in labels["annotations"]))
        self.assertIn("left as", call("calibrate", "--weights", out / "weights.safetensors", "--data", self.data, "--split", split, "--out", out / "calibrated.safetensors"))
        self.assertIn("expected --data to have the 3 pictures", call("evaluate", "--weights", out / "weights.safetensors", "--data", mix, "--split", split, status=2))

    def test_a_run_that_is_killed_or_stopped_goes_on_to_the_same_weights(self) -> None:
        out = self.root / "broken"
        command = [sys.executable, "-m", "smr_gpu_train", "fit", "--out", out]
        fresh = ["--data", self.data, "--network", "small", *TINY]
        for how, status in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
            with subprocess.Popen([*command, *(["--resume"] if out.exists() else fresh)], stdout=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                for line in process.stdout:
                    if " of 6, " in line:  # a step has been made
                        process.send_signal(how)
                        break
                process.stdout.read()
            self.assertEqual(process.returncode, status)
            self.assertFalse((out / "weights.safetensors").exists())
        step = torch.load(out / "checkpoint.pt", weights_only=True)["step"]
        self.assertTrue(0 < step < STEPS, step)
        # What there is can be had; other pictures are not taken for the same.
        self.assertIn(f"step {step}, ", call("export", "--run", out, "--out", out / "early.safetensors"))
        self.assertEqual(classes(out / "early.safetensors"), ["bayonet", "Ball_Catch"])
        call("fit", "--out", out, "--resume")
        one, other = (load_file(run / "weights.safetensors") for run in (self.whole, out))
        self.assertEqual(one.keys(), other.keys())
        for name, tensor in one.items():
            self.assertTrue(torch.equal(tensor, other[name]), name)
        self.assertEqual(history(out), [line for line in history(self.whole) if "val" not in line])
        self.assertIn("holds a run: give --resume", call("fit", "--out", out, *fresh, status=2))
        call("export", "--run", out, "--out", out / "again.safetensors")
        self.assertEqual((out / "again.safetensors").read_bytes(), (out / "weights.safetensors").read_bytes())

    def test_a_history_is_what_the_log_says_and_goes_on_with_the_run(self) -> None:
        lines = history(self.whole)
        self.assertEqual([line["step"] for line in lines], [*range(1, STEPS + 1), STEPS])
        self.assertEqual(lines[-1]["val"].keys(), {str(self.data)})
        rows = lines[-1]["val"][str(self.data)]
        self.assertEqual([*rows], ["bayonet", "Ball_Catch", "all"])
        self.assertLessEqual({"count", "iou", "ap50"}, rows["bayonet"].keys())
        self.assertTrue(all(line["steps"] == STEPS and f"loss {line['loss']:.4f}" in self.said for line in lines[:-1]))
        # Of a run of 25 steps every second is said. It was stopped between two, said more after its last checkpoint, and died in a line.
        out, once = self.root / "went-on", self.root / "at-once"
        arguments = ["--data", self.data, "--network", "small", *TINY, "--area", "10000", "--steps", "25"]
        call("fit", "--out", once, *arguments)
        command = [sys.executable, "-m", "smr_gpu_train", "fit", "--out", out, *map(str, arguments)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                if "step 8 of 25, " in line:
                    process.send_signal(signal.SIGKILL)
        kept = out / "history.jsonl"
        with open(kept, "a") as opened:
            opened.write('{"step": 24, "steps": 25, "loss": 9.0}\n{"step": 2')
        call("fit", "--out", out, "--resume")
        self.assertEqual(history(out), history(once))
        self.assertEqual([line["step"] for line in history(out)], [*range(2, 25, 2)])

    def test_a_history_that_cannot_be_written(self) -> None:
        out = self.root / "mute"
        (out / "history.jsonl").mkdir(parents=True)
        arguments = ["fit", "--out", out, "--data", self.data, "--network", "small", *TINY]
        self.assertIn("history.jsonl: cannot be written", call(*arguments, status=6))
        (out / "history.jsonl").rmdir()
        with subprocess.Popen([sys.executable, "-m", "smr_gpu_train", *map(str, arguments[:3]), "--resume"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None and process.stderr is not None
            for line in process.stdout:
                if "step 2 of 6, " in line:
                    (out / "history.jsonl").unlink()
                    (out / "history.jsonl").mkdir()
            self.assertIn("history.jsonl: cannot be written", process.stderr.read())
        self.assertEqual(process.returncode, 6)
        self.assertGreaterEqual(torch.load(out / "checkpoint.pt", weights_only=True)["step"], 1)
        (out / "history.jsonl").rmdir()
        call("fit", "--out", out, "--resume")
        self.assertEqual((out / "weights.safetensors").read_bytes(), (self.whole / "weights.safetensors").read_bytes())

    def test_one_process_trains_a_run(self) -> None:
        with locked(self.whole) as ours:
            self.assertTrue(ours)
            self.assertIn("that no other process trains", call("fit", "--out", self.whole, "--resume", status=2))

    def test_a_run_goes_on_with_its_own_pictures_alone(self) -> None:
        out, data = self.root / "moved", self.root / "moved-data"
        shutil.copytree(self.data, data)
        call("fit", "--out", out, "--data", data, "--network", "small", *TINY, "--steps", "1")
        pictures = sorted((data / "images").glob("*.png"))
        shutil.copy(pictures[0], pictures[1])
        self.assertIn("expected the pictures and labels that the run began with", call("fit", "--out", out, "--resume", status=2))

    def test_heads_of_classes_that_a_file_has_stay(self) -> None:
        data, out = self.root / "other", self.root / "from"
        shutil.copytree(self.data, data)
        labels = data / "annotations.json"
        labels.write_text(labels.read_text().replace('"bayonet"', '"clip"'))
        first = self.whole / "weights.safetensors"
        # At a rate of zero nothing is learnt: what differs began anew.
        said = call("fit", "--out", out, "--data", data, "--init", first, "--classes", "ball_catch", "clip", "--lr", "0", "--keep-statistics", *TINY, "--steps", "1")
        self.assertIn("its heads say nothing of clip, which begin anew", said)
        self.assertEqual(classes(out / "weights.safetensors"), ["ball_catch", "clip"])
        before, after = load_file(first), load_file(out / "weights.safetensors")
        for name, tensor in before.items():
            rows = {"roi_head.cls_score": 1, "roi_head.bbox_pred": 4}.get(name.rpartition(".")[0])
            if rows is None:
                self.assertTrue(torch.equal(tensor, after[name]), name)
                continue
            background, bayonet, catch = tensor.split(rows)
            got = after[name].split(rows)
            self.assertTrue(torch.equal(got[0], background) and torch.equal(got[1], catch), name)
            self.assertFalse(torch.equal(got[2], bayonet) and name.endswith("weight"), name)
        # A file that is none.
        self.assertIn("expected a weight file of SMR-Net", call("fit", "--out", self.root / "none", "--data", data, "--init", labels, *TINY, status=2))

    def test_one_class_without_directions(self) -> None:
        data, out = self.root / "one", self.root / "one-run"
        shutil.copytree(self.data, data)
        labels = data / "annotations.json"
        coco = json.loads(labels.read_text())
        coco["categories"] = [{"id": 5, "name": "κλιπ"}]
        for annotation in coco["annotations"]:
            annotation.update(category_id=5, yaw_deg=None)
        labels.write_text(json.dumps(coco))
        call("fit", "--out", out, "--data", data, "--network", "small", *TINY, "--steps", "1")
        self.assertEqual(classes(out / "weights.safetensors"), ["κλιπ"])
        said = call("evaluate", "--weights", out / "weights.safetensors", "--data", data, "--limit", "2")
        self.assertIn("κλιπ: count ", said)
        self.assertIn("expected labels of κλιπ, got `", call("evaluate", "--weights", out / "weights.safetensors", "--data", self.data, status=2))

    def test_calibration_leaves_what_too_few_pictures_say(self) -> None:
        out = self.root / "calibrated.safetensors"
        said = call("calibrate", "--weights", self.whole / "weights.safetensors", "--data", self.data, "--limit", "3", "--out", out)
        self.assertIn("left as", said)
        self.assertEqual(classes(out), ["bayonet", "Ball_Catch"])

    def test_outputs_that_cannot_be_written(self) -> None:
        (self.root / "file").write_text("")
        said = call("export", "--run", self.whole, "--out", self.root / "file" / "x.safetensors", status=6)
        self.assertIn("x.safetensors: cannot be written", said)
        # A disk that is full once the pictures are packed: checkpoints are larger.
        out = self.root / "full"
        said = call("fit", "--out", out, "--data", self.data, "--network", "small", *TINY, status=6, room=4_000_000)
        self.assertIn("checkpoint.pt: cannot be written", said)
        self.assertEqual(sorted(file.name for file in out.iterdir()), ["cache", "history.jsonl", "lock", "run.json"])
        call("fit", "--out", out, "--resume")
        self.assertTrue((out / "weights.safetensors").exists())
        said = call("fit", "--out", self.root / "file" / "run", "--data", self.data, *TINY, status=6)
        self.assertIn("cannot be written", said)


if __name__ == "__main__":
    unittest.main()
