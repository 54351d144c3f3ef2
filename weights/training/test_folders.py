"""Folders by pattern, and names with typing errors. `python test_folders.py`, which needs no torch"""

import tempfile
from pathlib import Path

import folders


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for folder in ("sets/a_1", "sets/a_2", "sets/b"):
            (root / folder).mkdir(parents=True)
        for folder in ("sets/a_2", "sets/b"):
            (root / folder / folders.LABELS).write_text("{}")
        here = lambda *patterns: [f"{root}/{pattern}" for pattern in patterns]
        assert folders.found(here("sets/b", "sets/a_*")) == here("sets/b", "sets/a_2")
        assert folders.found(here("sets/b", "sets/*", "sets/b/", "sets/a_1/../b")) == here("sets/b", "sets/a_2")
        # What a simulation still writes, or is about to, is waited for.
        assert folders.missing(here("sets/a_1", "sets/a_*", "sets/c_*", "*/a_1")) == []
        assert folders.missing(here("sets/a1", "set/a_*", "sets/d/*/x")) == here("sets/a1", "set", "sets/d")
        try:
            folders.refuse_missing("--data", here("sets/b", "set/*"))
            raise AssertionError("a typing error is waited for")
        except SystemExit as error:
            assert str(error) == f"--data: expected folders, got {root}/set, which is not there", error
        folders.refuse_missing("--data", here("sets/b"))
    print("ok")


if __name__ == "__main__":
    main()
