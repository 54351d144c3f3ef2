"""What is read of folders and said of mistakes, without torch: `python3 -m unittest tests/test_labels.py`"""

import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from typing import Any

HERE = Path(__file__).parents[1]
sys.path.insert(0, str(HERE))

from smr_gpu_train import cli  # noqa: E402
from smr_gpu_train.errors import Failure  # noqa: E402
from smr_gpu_train.labels import Counts, data_set, read_folder  # noqa: E402
from smr_gpu_train.request import Request  # noqa: E402
from smr_gpu_train.sensor import NAMED, Rect, Sensor, view  # noqa: E402
from smr_gpu_train.split import held_out, hold_out, save  # noqa: E402

CATEGORIES = [{"id": 1, "name": "bayonet"}, {"id": 7, "name": "ball_catch"}]


def images(count: int, **more: Any) -> list[dict[str, Any]]:
    return [{"id": i, "file_name": f"{i}.png", "width": 1000, "height": 1000, "mm_per_pixel": 0.04, **more} for i in range(count)]


def snap(image: int, category: int, bbox: list[float], **more: Any) -> dict[str, Any]:
    return {"image_id": image, "category_id": category, "bbox": bbox, **more}


class Folders(unittest.TestCase):
    def setUp(self) -> None:
        self.kept = tempfile.TemporaryDirectory()
        self.addCleanup(self.kept.cleanup)
        self.root = Path(self.kept.name)

    def write(self, name: str = "set", there: bool = True, **coco: Any) -> Path:
        folder = self.root / name
        folder.mkdir(exist_ok=True)
        coco = {"images": images(2), "annotations": [snap(0, 1, [10, 20, 30, 40]), snap(1, 7, [10, 20, 30, 40])], "categories": CATEGORIES, **coco}
        (folder / "annotations.json").write_text(json.dumps(coco))
        for image in coco["images"]:
            # The reader of labels does not open pictures.
            file = folder / image.get("file_name", "")
            file.write_bytes(b"") if there else file.unlink(missing_ok=True)
        return folder

    def fails(self, wanted: str, **coco: Any) -> None:
        folder = self.write(**coco)
        with self.assertRaises(Failure) as caught:
            data_set([read_folder(folder)])
        self.assertIn(wanted, str(caught.exception))
        self.assertNotIn("\n", str(caught.exception))

    def test_own_names_in_any_case_are_classes(self) -> None:
        one = read_folder(self.write("one", annotations=[snap(0, 1, [10, 20, 30, 40], yaw_deg=90.0), snap(0, 1, [1, 2, 3, 4], yaw_deg=None)]))
        other = read_folder(self.write("other", categories=[{"id": 3, "name": "Ball_Catch"}, {"id": 4, "name": "Bayonet"}], annotations=[snap(0, 3, [0, 0, 5, 5])]))
        data = data_set([one, other])
        self.assertEqual((data.classes, data.directed), (["bayonet", "ball_catch"], ["bayonet"]))
        self.assertEqual(data.summary(), ["4 pictures, 2 of them without a snap; 3 snaps: bayonet 2 (with a direction), ball_catch 1"])
        self.assertEqual(data_set([one, other], ["BALL_CATCH", "Bayonet"]).directed, ["Bayonet"])
        self.assertEqual(data_set([one, other], directed=[]).directed, [])

    def test_classes_that_cannot_be(self) -> None:
        for wanted, names in {
            "1 categories without a name: id 2": ["a", " "],
            "1 categories of a name that another has, capitals apart: `A` and `a`": ["a", "A"],
            "1 categories with a name of more than 64 characters": ["a" * 65],
            "expected 1 to 10 classes, got 11": list("abcdefghijk"),
            "expected snaps of every class, got none of b; name the classes that there are by --classes": ["a", "b"],
            "expected 1 to 10 classes, got 0": [],
        }.items():
            rows = [{"id": i, "name": name} for i, name in enumerate(names, start=1)]
            self.fails(wanted, categories=rows, annotations=[snap(0, 1, [1, 1, 5, 5])] if names else [])
        folders = [read_folder(self.write(annotations=[snap(0, 1, [1, 1, 5, 5]), snap(1, 7, [1, 1, 5, 5]), snap(1, 7, [1, 1, 5, 5])]))]
        for classes, wanted in {("bayonet",): "expected labels of bayonet, got `ball_catch` (2 snaps)", ("bayonet", "x", "ball_catch"): "--classes: expected snaps of every class, got none of x"}.items():
            with self.assertRaises(Failure) as caught:
                data_set(folders, classes)
            self.assertIn(wanted, str(caught.exception))
        with self.assertRaisesRegex(Failure, "--directed: expected labels with a yaw_deg, got none of bayonet"):
            data_set(folders, directed=["Bayonet"])

    def test_labels_that_cannot_be_are_counted_and_named(self) -> None:
        boxes = [snap(0, 1, [990, 10, 30, 40], id=5), snap(1, 1, [-2, 10, 30, 40], id=6), snap(0, 1, [0, 0, 1001, 1001], id=7)]
        self.fails("2 boxes outside their picture: annotation 5 (990, 10 to 1020, 50 in the 1000 x 1000 pixels of 0.png), annotation 6", annotations=boxes)
        self.fails("1 annotations of an unknown category: annotation at position 0 of category 9", annotations=[snap(0, 9, [1, 1, 5, 5])])
        self.fails("1 annotations of an image that is not there: annotation at position 0 of image 9", annotations=[snap(9, 1, [1, 1, 5, 5])])
        for bbox in ([1, 1, 0, 5], [1, 1, 5], [1, 1, 5, float("nan")], "box", [1, 1, True, 5]):
            self.fails("1 annotations without a bbox of finite numbers with width and height above 0", annotations=[snap(0, 1, bbox)])  # type: ignore[arg-type]
        self.fails("1 annotations with a yaw_deg that is no number: annotation at position 0 with left", annotations=[snap(0, 1, [1, 1, 5, 5], yaw_deg="left")])
        self.fails("4 pictures that are not there: 0.png, 1.png, 2.png and 1 more", there=False, images=images(4))
        self.fails("2 images without a width and a height above 0: 0.png, 1.png", images=images(2, width=None))
        self.fails("2 pictures whose scale or gel cannot be: 0.png has a scale of 40.0 mm a pixel", images=images(2, mm_per_pixel=40))
        self.fails("0.png has a field of 100 mm along the gel's longer side", images=images(2, mm_per_pixel=0.1))
        self.fails("0.png has a gel of 900, 0, 200, 100", images=images(2, gel={"x": 900, "y": 0, "width": 200, "height": 100}))
        self.fails("1 images that share their file_name with others: 0.png", images=[*images(1), {**images(1)[0], "id": 9}])
        self.fails("1 images without id: position 0", images=[{"file_name": "a.png"}])
        self.fails("expected at least one image, got none", images=[], annotations=[])

    def test_what_is_left_out_or_assumed_is_said(self) -> None:
        folder = self.write(images=images(2, mm_per_pixel=None, gel={"x": 100, "y": 0, "width": 500, "height": 1000}), annotations=[snap(0, 1, [10, 20, 30, 40]), snap(0, 1, [200, 200, 30, 40]), snap(1, 1, [200, 20, 30, 40], iscrowd=1)])
        (folder / "more.png").write_bytes(b"")
        read = read_folder(folder)
        self.assertEqual(len(read.remarks), 4)
        for wanted in ("2 pictures of 1000 x 1000 pixels without a scale: 0.0800 mm a pixel assumed", "1 crowd left out", "1 box outside the gel left out", "1 picture left out that annotations.json does not name: more.png"):
            self.assertTrue(any(wanted in remark for remark in read.remarks), (wanted, read.remarks))
        # Of a field that nobody stated the middle 60 mm count.
        self.assertEqual(read.pictures[0].part, Rect(100, 125, 500, 750))
        stated = read_folder(folder, NAMED["plain"])
        self.assertEqual(stated.pictures[0].mm_per_pixel, 0.08)

    def test_pictures_lie_beside_the_labels_or_in_images(self) -> None:
        folder = self.write(there=False, images=[{**images(1)[0], "file_name": "a\\0.png"}], annotations=[])
        (folder / "images" / "a").mkdir(parents=True)
        (folder / "images" / "a" / "0.png").write_bytes(b"")
        self.assertEqual(read_folder(folder).pictures[0].path, folder / "images" / "a" / "0.png")

    def test_a_mix_brings_classes_and_directions(self) -> None:
        own = self.write("own", annotations=[snap(0, 1, [10, 20, 30, 40])])
        mix = self.write("mix", images=images(3), categories=[{"id": 2, "name": "Bayonet"}, {"id": 3, "name": "clip"}], annotations=[snap(0, 2, [0, 0, 5, 5], yaw_deg=3.0), snap(1, 3, [0, 0, 5, 5])])
        data, _ = Request([str(own)], [], 6, mix=[str(mix)], mix_share=0.25, classes=["bayonet", "clip"]).pictures()
        self.assertEqual(([folder.path for folder in data.folders], [folder.path for folder in data.mix], data.mix_share), ([own], [mix], 0.25))
        self.assertEqual(data.summary(), ["2 pictures, 1 of them without a snap; 1 snap: bayonet 1 (with a direction), clip 0", "mixed in, 25 % of all views: 3 pictures, 1 of them without a snap; 2 snaps: bayonet 1 (with a direction), clip 1"])
        self.assertEqual(data.counts(), Counts(5, 2, {"bayonet": 2, "clip": 1}))

    def different(self, name: str, shown: list[list[int]], **more: Any) -> Path:
        """A folder of pictures of different bytes, which show these categories."""
        annotations = [snap(i, category, [10, 20, 30, 40]) for i, each in enumerate(shown) for category in each]
        folder = self.write(name, images=images(len(shown)), annotations=annotations, **more)
        for i in range(len(shown)):
            (folder / f"{i}.png").write_text(f"{name} {i}")
        return folder

    def test_a_split_holds_out_of_each_class_alike_by_bytes(self) -> None:
        folder = self.different("many", [[1]] * 20 + [[7]] * 10 + [[]] * 10)
        names = lambda folders: sorted(p.path.name for f in folders for p in f.pictures)  # noqa: E731
        kept, held, remarks = hold_out([read_folder(folder)], 0.2)
        self.assertEqual(len(names(kept)), 32)
        self.assertEqual(sorted(names(kept) + names(held)), sorted(f"{i}.png" for i in range(40)))
        self.assertEqual([sum(low <= int(name[:-4]) < high for name in names(held)) for low, high in ((0, 20), (20, 30), (30, 40))], [4, 2, 2])
        self.assertEqual(remarks, ["8 of 40 pictures held out"])
        # The bytes decide, not the name or the folder; pictures of the same bytes land together.
        turned = self.different("turned", [[1]] * 20 + [[7]] * 10 + [[]] * 10)
        for i in range(40):
            (turned / f"{i}.png").write_bytes((folder / f"{(i + 7) % 20 if i < 20 else i}.png").read_bytes())
        bytes_of = lambda folders: {p.path.read_bytes() for f in folders for p in f.pictures}  # noqa: E731
        self.assertEqual(bytes_of(hold_out([read_folder(turned)], 0.2)[1]), bytes_of(held))
        twice_kept, twice_held, _ = hold_out([read_folder(folder), read_folder(turned)], 0.2)
        self.assertEqual((len(names(twice_kept)), len(names(twice_held)), bytes_of(twice_held)), (64, 16, bytes_of(held)))
        # What is listed is found again, wherever it lies, or missed.
        save(self.root, 0.2, held)
        self.assertEqual(bytes_of(held_out("--data", self.root / "split.json", [read_folder(turned)])), bytes_of(held))
        for i in range(20):
            (turned / f"{i}.png").write_text("other")
        with self.assertRaisesRegex(Failure, "expected --data to have the 8 pictures that .*split.json lists, got none like .*many/.* and 1 more"):
            held_out("--data", self.root / "split.json", [read_folder(turned)])
        for text in ("{", "[]", '{"held_out": [{}]}'):
            (self.root / "split.json").write_text(text)
            with self.assertRaisesRegex(Failure, "expected the split.json of a run, got"):
                held_out("--data", self.root / "split.json", [read_folder(turned)])

    def test_a_split_leaves_some_of_each_class(self) -> None:
        for shown, share, wanted in [
            ([[1], [7]], 0.5, (2, 0)),  # the only ones
            ([[1, 7]], 0.9, (1, 0)),
            ([[1, 7]] * 4, 0.1, (4, 0)),
            ([[1, 7]] * 5, 0.1, (4, 1)),
            ([[1, 7]] * 5, 0.99, (1, 4)),
            ([[1]] * 9 + [[7]], 0.9, (2, 8)),
        ]:
            kept, held, remarks = hold_out([read_folder(self.different("small", shown))], share)
            self.assertEqual(tuple(sum(len(f.pictures) for f in side) for side in (kept, held)), wanted, shown)
            self.assertEqual({label.category for f in kept for p in f.pictures for label in p.labels}, {"bayonet", "ball_catch"})
            unseen = {"bayonet", "ball_catch"} - {label.category for f in held for p in f.pictures for label in p.labels}
            self.assertEqual(remarks[1:], [f"no picture of {', '.join(sorted(unseen))} is held out: too few show it"] if unseen else [])

    def test_a_request_with_a_split(self) -> None:
        folder = self.different("asked", [[1], [7]] * 5)
        data, val = Request([str(folder)], [], 6, split=0.2).pictures()
        self.assertEqual([len(f.pictures) for f in (*data.folders, *val)], [8, 2])
        self.assertEqual(data.summary(), ["8 pictures, 0 of them without a snap; 8 snaps: bayonet 4, ball_catch 4", "2 of 10 pictures held out"])
        copied = self.different("copied", [[1], [7]] * 5)
        (copied / "3.png").write_bytes(val[0].pictures[0].path.read_bytes())
        with self.assertRaisesRegex(Failure, "--mix: expected no picture that is held out, got .*copied/3.png"):
            Request([str(folder)], [], 6, mix=[str(copied)], split=0.2).pictures()
        with self.assertRaisesRegex(Failure, "--val, beside --split: expected other folders than --data, got"):
            Request([str(folder)], [str(folder)], 6, split=0.2).pictures()

    def ends(self, arguments: list[str], status: int, wanted: str) -> None:
        """A command ends so, with one line."""
        # Without site packages there is no torch.
        done = subprocess.run([sys.executable, "-S", "-m", "smr_gpu_train", *arguments], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(HERE)})
        self.assertEqual(done.returncode, status, done.stderr)
        self.assertIn(wanted, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)

    def test_mistakes_end_at_once_in_a_line(self) -> None:
        sound, out = self.write(), self.root / "run"
        bare = self.write("bare", images=[], annotations=[])
        mix = self.write("mix", categories=[{"id": 1, "name": "clip"}], annotations=[snap(0, 1, [10, 20, 30, 40])])
        begin = ["fit", "--out", str(out), "--steps", "6", "--data"]
        for arguments, status, wanted in [
            ([], 2, "the following arguments are required: COMMAND"),
            (["fit", "--out", str(out)], 2, "expected --data and --steps, or --resume"),
            ([*begin, str(sound), "--steps", "0"], 2, "fit: argument --steps: expected a whole number from 1 on, got 0"),
            ([*begin, str(sound), "--steps", "1.5"], 2, "fit: argument --steps: expected a whole number from 1 on, got 1.5"),
            ([*begin, str(sound), "--lr", "nan"], 2, "fit: argument --lr: expected a number from 0 on, got nan"),
            ([*begin, str(self.root / "sett"), str(sound)], 2, f"--data: expected folders, got {self.root}/sett, which is not there"),
            ([*begin, str(self.root)], 2, f"--data: expected folders with annotations.json (COCO), got {self.root} without it"),
            ([*begin, str(sound), "--val", str(self.root / "x")], 2, f"--val: expected folders, got {self.root}/x"),
            ([*begin, str(sound), "--init", "x.safetensors"], 2, "--init: expected a weight file, got x.safetensors, which is not there"),
            ([*begin, str(sound), "--init", str(sound / "0.png"), "--network", "small"], 2, "--init brings its own configuration: leave out --network"),
            ([*begin, str(sound), "--sensor", "papers"], 2, "--sensor: expected paper, gelsight-mini, digit, plain or a sensor file, got papers"),
            ([*begin, str(sound), "--sensor", "paper", "--classes", "a"], 2, "expected labels of a, got `bayonet` (1 snap), `ball_catch` (1 snap)"),
            *(([*begin, str(sound), "--mix", str(mix), "--mix-share", share], 2, f"--mix-share: expected a share between 0 and 1, got {share}") for share in ("0", "1")),
            ([*begin, str(sound), "--mix-share", "0.3"], 2, "--mix-share: give --mix, whose share it is"),
            ([*begin, str(sound), "--mix", str(mix), str(sound)], 2, f"--mix: expected other folders than --data, got {sound}"),
            ([*begin, str(sound), "--mix", str(mix), "--classes", "bayonet", "ball_catch"], 2, f"{mix}/annotations.json: expected labels of bayonet, ball_catch, got `clip` (1 snap)"),
            ([*begin, str(sound), "--split", "1"], 2, "--split: expected a share between 0 and 1, got 1"),
            ([*begin, str(bare), "--split", "0.2"], 2, f"{bare}/annotations.json: expected at least one image, got none"),
            (["fit", "--out", str(out), "--resume"], 2, f"{out}: expected a run with run.json, got none"),
            (["fit", "--out", str(out), "--resume", "--steps", "7"], 2, "--resume goes on as the run was begun: leave out --steps"),
            ([*begin, str(sound)], 1, "is not installed: pip install weights/training"),
            (["evaluate", "--weights", "x", "--data", str(sound)], 1, "is not installed"),
        ]:
            with self.subTest(arguments):
                self.ends(arguments, status, wanted)
        (sound / "annotations.json").write_text("{")
        self.ends([*begin, str(sound)], 2, f"{sound}/annotations.json: expected COCO's JSON, got an error")
        (sound / "annotations.json").write_text("[]")
        self.ends([*begin, str(sound)], 2, "expected COCO's JSON with images, annotations and categories")
        self.assertFalse(out.exists())

    def test_help_shows_the_commands(self) -> None:
        said = io.StringIO()
        with contextlib.redirect_stdout(said), self.assertRaises(SystemExit):
            cli.main(["--help"])
        for command in ("fit", "evaluate", "calibrate", "export", "onnx"):
            self.assertIn(command, said.getvalue())


class Scales(unittest.TestCase):
    """The figures of the program's own tests in src/sensor."""

    def test_frames_of_the_known_sensors(self) -> None:
        for name, size, gel, mm in [
            ("paper", (1920, 1200), (460, 100, 1000, 1000), 0.04),
            ("paper", (960, 600), (230, 50, 500, 500), 0.08),
            ("paper", (250, 250), (0, 0, 250, 250), 0.16),
            ("gelsight-mini", (320, 240), (0, 0, 320, 240), 0.0634),
            ("gelsight-mini", (640, 480), (0, 0, 640, 480), 0.0317),
            ("gelsight-mini", (3280, 2464), (492, 370, 2296, 1724), 20.288 / 2296),
            ("digit", (240, 320), (0, 0, 240, 320), 0.059375),
            ("digit", (480, 640), (0, 0, 480, 640), 0.0296875),
        ]:
            window, scale = NAMED[name].sense(size)
            self.assertEqual(window, gel)
            self.assertAlmostEqual(scale or 0, mm)
        with self.assertRaisesRegex(Failure, "sensor `paper`: expected frames of the shape of 1920 x 1200 pixels, or of its gel's 1000 x 1000; got 640 x 480"):
            NAMED["paper"].sense((640, 480))

    def test_the_first_that_says_it_counts(self) -> None:
        gel = Rect(400, 100, 800, 900)
        for size, mm, stated, sensor, part, scale, assumed in [
            ((1920, 1200), 0.05, gel, "paper", gel, 0.05, False),
            ((1920, 1200), None, None, "paper", (460, 100, 1000, 1000), 0.04, False),
            ((320, 240), None, None, "digit", (0, 0, 320, 240), 0.059375, False),
            # Nobody says a sensor: the paper's frame by its shape, unless its stated scale is another.
            ((1920, 1200), None, None, None, (460, 100, 1000, 1000), 0.04, True),
            ((1280, 800), None, None, None, (307, 67, 666, 666), 40 / 666, True),
            ((1920, 1200), 0.045, None, None, (460, 100, 1000, 1000), 0.045, False),
            ((1920, 1200), 0.0299, None, None, (0, 0, 1920, 1200), 0.0299, False),
            # 40 mm along the shorter side, and of the longer one 60.
            ((320, 240), None, None, None, (0, 0, 320, 240), 40 / 240, True),
            ((800, 400), None, None, None, (100, 0, 600, 400), 0.1, True),
            ((320, 240), None, None, "plain", (0, 0, 320, 240), 40 / 240, True),
        ]:
            seen = view(size, mm, stated, NAMED[sensor] if sensor else None)
            self.assertEqual((seen.part, seen.assumed), (part, assumed), size)
            self.assertAlmostEqual(seen.mm_per_pixel, scale)

    def test_a_sensor_file(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "sensor.json"
            file.write_text('{"name": "lens", "frame": [300, 400], "mm_per_pixel": 0.05, "distortion": -0.1, "other_frames": [{"frame": [1000, 800], "mm_per_pixel": 0.025, "gel": {"x": 200, "y": 0, "width": 600, "height": 800}}]}')
            sensor = Sensor.open(str(file))
            self.assertEqual(sensor.sense((1000, 800)), ((200, 0, 600, 800), 0.025))
            self.assertEqual(sensor.sense((600, 800)), ((0, 0, 600, 800), 0.025))
            for text in ("{", "[]", '{"frame": [1, 2]}', '{"name": "a", "frame": [1]}', '{"name": "a", "frame": [10, 10], "gel": {"x": 5, "y": 0, "width": 6, "height": 1}}'):
                file.write_text(text)
                with self.assertRaisesRegex(Failure, "expected a sensor's JSON, got"):
                    Sensor.open(str(file))


if __name__ == "__main__":
    unittest.main()
