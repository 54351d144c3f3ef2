"""Which COCO folders patterns name. Without torch, so that a mistake is told before that is loaded."""

import glob
import itertools
from pathlib import Path

LABELS = "annotations.json"


def found(patterns: list[str]) -> list[str]:
    """Folders that are complete, in the order of the patterns: a data set's labels are written last. Each once, whatever names it has."""
    complete = [folder for pattern in patterns for folder in sorted(glob.glob(pattern)) if (Path(folder) / LABELS).exists()]
    once: dict[Path, str] = {}
    for folder in complete:
        once.setdefault(Path(folder).resolve(), folder)
    return list(once.values())


def missing(patterns: list[str]) -> list[str]:
    """Folders without which a pattern can match nothing: itself, or what is before its first wildcard."""
    parts = [itertools.takewhile(lambda part: not glob.has_magic(part), Path(pattern).parts) for pattern in patterns]
    return [str(folder) for folder in (Path(*p) for p in parts) if not folder.is_dir()]


def refuse_missing(option: str, patterns: list[str]) -> None:
    """Ends the program with the folders that are not there: nobody waits for a name with a typing error."""
    if gone := missing(patterns):
        raise SystemExit(f"{option}: expected folders, got {', '.join(gone)}, which {'is' if len(gone) == 1 else 'are'} not there")
