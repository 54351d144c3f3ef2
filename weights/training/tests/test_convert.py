"""The commands of README.md that make COCO labels of YOLO text and Pascal VOC. `python tests/test_convert.py`"""

import re
import shlex
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

from PIL import Image

from smr_gpu_train.labels import data_set, read_folder

README = Path(__file__).parents[1] / "README.md"
VOC = """<annotation><folder>images</folder><filename>{i}.png</filename><size><width>400</width><height>300</height><depth>3</depth></size>
<object><name>clip</name><bndbox><xmin>150</xmin><ymin>75</ymin><xmax>250</xmax><ymax>225</ymax></bndbox></object></annotation>"""


class Convert(unittest.TestCase):
    def test_commands(self) -> None:
        commands = re.findall(r"^globox convert .*$", README.read_text(), re.MULTILINE)
        self.assertEqual(len(commands), 2)
        for command in commands:
            with self.subTest(command), tempfile.TemporaryDirectory() as name:
                root = Path(name)
                for folder in ("images", "labels"):
                    (root / "DATA" / folder).mkdir(parents=True)
                (root / "DATA" / "names.txt").write_text("clip\npin\n")
                for i in range(3):
                    Image.new("RGB", (400, 300)).save(root / "DATA" / "images" / f"{i}.png")
                    (root / "DATA" / "labels" / f"{i}.txt").write_text("0 0.5 0.5 0.25 0.5\n")
                    (root / "DATA" / "labels" / f"{i}.xml").write_text(VOC.format(i=i))
                words = shlex.split(command, comments=True)
                subprocess.run([Path(sys.executable).parent / words[0], *words[1:]], cwd=root, check=True, capture_output=True)
                read = read_folder(root / "DATA")
                self.assertEqual(data_set([read], ["clip"]).classes, ["clip"])
                self.assertEqual([[label.box for label in picture.labels] for picture in read.pictures], [[(150, 75, 250, 225)]] * 3)


if __name__ == "__main__":
    unittest.main()
