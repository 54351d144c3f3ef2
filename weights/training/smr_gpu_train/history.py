"""What a run said of itself, as JSON lines: OUT/history.jsonl. Needs no torch."""

import json
import math
from pathlib import Path
from typing import Any

from .errors import Unwritable
from .files import whole

FILE = "history.jsonl"


def plain(value: Any) -> Any:
    """As JSON has it: null where a number is none."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


class History:
    """Lines that programs read while the run goes on, each written at once."""

    def __init__(self, file: Path):
        self.file = file

    def back(self, step: int, steps: int) -> None:
        """Keeps what was said up to a checkpoint's step; the last validation, after all steps, is made again."""
        kept = []
        with whole(self.file) as part:
            for line in self.file.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True) if self.file.exists() else []:
                try:
                    said = json.loads(line)
                    if said["step"] <= step and not ("val" in said and said["step"] >= steps):
                        kept.append(line)
                except (ValueError, KeyError, TypeError):  # torn
                    break
            part.write_text("".join(kept), encoding="utf-8")

    def add(self, said: dict[str, Any]) -> None:
        """Raises `Unwritable`."""
        try:
            with open(self.file, "a", encoding="utf-8") as opened:
                opened.write(json.dumps(plain(said)) + "\n")
        except OSError as error:
            raise Unwritable(f"{self.file}: cannot be written: {error.strerror}") from None
