"""The compiled part; unstable."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Given = str | tuple[NDArray[np.uint8], str]

class Detector:
    classes: list[str]
    adapter: str
    remarks: list[str]
    def __init__(self, options: dict[str, Any]) -> None: ...
    def detect(self, given: Given, said: dict[str, Any]) -> dict[str, Any]: ...
    def detect_many(self, given: list[Given], said: dict[str, Any]) -> list[dict[str, Any]]: ...
    def stream(self, frames: Iterator[Given], said: dict[str, Any]) -> Stream: ...
    def camera(self) -> Camera: ...

class Stream(Iterator[dict[str, Any]]):
    def __next__(self) -> dict[str, Any]: ...

class Camera:
    def detect(self, given: Given, said: dict[str, Any]) -> dict[str, Any]: ...
