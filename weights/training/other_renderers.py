"""Pictures of snaps by renderers that share nothing with `smr-gpu simulate`, as COCO folders OUT/LOOK-SCENE.

Sharp shapes as CAD has them; gel that follows by Gaussians, as in Taxim (Si and Yuan 2022), not by elasticity; and
seven looks: three coloured lamps with highlights on two fields of view, the same under a soft gel, one white lamp, a
map of the normals, a gel that darkens with depth and slope, and a grey one that darkens with depth alone (`coat`). The
scenes are `snaps` and other things, other things alone (`none`), snaps on a gel with printed dots (`markers`), hooks
with the wall they grow from (`wall`), which is in no box, two snaps 0.3 to 1.2 mm apart (`pairs`), snaps of 3.5 to
5 mm (`small`), hooks with other barbs (`barbs`), and round things with bright and dark rims (`round`). No network of
weights/ was trained on such pictures, or chosen by them.

`other_renderers.py --out OUT --count 100 --seed 1`, then `smr-gpu eval --exact --data OUT/*/`

With `--part NAME=MAP.png:MM_PER_PIXEL:MM_AT_WHITE`, a height map as `smr-gpu simulate --part` takes it, classes are
such parts in place of hooks and studs. What is easily taken for them, a block of the outline and the part without the
third that it points to, and hooks and studs are then among the other things, and there are no walls.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

Plane = np.ndarray
BESIDE = -9.0  # mm: where a part has no height, deeper than any is pressed
FREE_MM = 12.0  # between the middles of two parts
MARGIN_MM = 6.0  # between the middle of a part and the edge
GAP_MM = (0.3, 1.2)  # between the contacts of a pair
PRESSED = (0.5, 1.4)  # mm: how deep
TILT_DEG = 2  # at most
DEEPEST_MM = 1.6  # of a part of one's own what lies deeper is not seen

# In the order of the seeds: a scene's number is part of them.
SCENES = ("none", "snaps", "markers", "wall", "pairs", "small", "barbs", "round")
WITHOUT_SNAPS = ("none", "round")

# A look's millimetres a pixel, width and height.
LOOKS = {
    "lamps": (0.06, 640, 480),
    "lamps-near": (0.0634, 320, 240),
    "soft": (0.08, 480, 480),
    "white": (0.04, 1000, 1000),
    "normals": (0.1, 400, 400),
    "depth": (0.06, 640, 480),
    "coat": (0.05, 640, 480),
}


def turned(x: Plane, y: Plane, angle: float) -> tuple[Plane, Plane]:
    """Positions along a direction and across it."""
    cos, sin = np.cos(angle), np.sin(angle)
    return x * cos + y * sin, y * cos - x * sin


def rectangle(x: Plane, y: Plane, length: float, width: float) -> Plane:
    return (abs(x) <= length / 2) & (abs(y) <= width / 2)


Range = tuple[float, float]  # of a uniform draw, mm


def hook(
    rng: np.random.Generator, x: Plane, y: Plane, *, length_mm: Range = (6, 10), width_mm: Range = (3, 5), undercut_mm: Range = (0.5, 0.8), lead_in_deg: Range = (25, 35), top_mm: Range = (0.2, 0.8), shaped: bool = False
) -> Plane:
    """Kind A: an arm along x, a barb with a steep face and a lead-in at its end; `shaped`, that barb is narrower than the arm or round across, as often as not."""
    length, width, undercut = rng.uniform(*length_mm), rng.uniform(*width_mm), rng.uniform(*undercut_mm)
    slope = np.tan(np.radians(rng.uniform(*lead_in_deg)))
    face = length / 2 - rng.uniform(*top_mm) - undercut / slope
    barb = np.where(x >= face, np.minimum(undercut, (length / 2 - x) * slope), 0)
    if shaped:
        across = abs(y) / (rng.uniform(0.5, 1) * width / 2)
        barb = barb * (np.sqrt(np.maximum(1 - across**2, 0)) if rng.random() < 0.5 else across <= 1)
    return np.where(rectangle(x, y, length, width), barb - undercut, BESIDE)


def stud(rng: np.random.Generator, x: Plane, y: Plane, *, radius_mm: Range = (2.5, 4), bead_mm: Range = (0.3, 0.5), wall_mm: Range = (0.7, 1.2)) -> Plane:
    """Kind B: a ring with a bevelled bead and two to four slots."""
    radius, bead, wall = rng.uniform(*radius_mm), rng.uniform(*bead_mm), rng.uniform(*wall_mm)
    slots, half_slot, phase = rng.integers(2, 5), rng.uniform(0.3, 0.6), rng.uniform(0, 2 * np.pi)
    r = np.hypot(x, y)
    bevel = np.maximum(r - (radius - bead), 0) * np.tan(np.radians(35))
    height = np.where((r <= radius) & (r >= radius - bead - wall), -bevel, BESIDE)
    for angle in phase + 2 * np.pi * np.arange(slots) / slots:
        along, across = turned(x, y, angle)
        height[(along > 0) & (abs(across) < half_slot)] = BESIDE
    return height


def wall(rng: np.random.Generator, x: Plane, y: Plane, root: float) -> Plane:
    """A plate across a hook's root, as high as its barb or up to 0.7 mm lower."""
    plate = (x < root) & (x > root - rng.uniform(1.2, 2.5)) & (abs(y) < rng.uniform(3.5, 7))
    return np.where(plate, rng.uniform(-0.7, 0), BESIDE)


def block(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    return np.where(rectangle(x, y, rng.uniform(6, 10), rng.uniform(3, 5)), 0, BESIDE)


def disc(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    return np.where(np.hypot(x, y) < rng.uniform(1.5, 4), 0, BESIDE)


def tube(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    radius = rng.uniform(2.5, 4)
    r = np.hypot(x, y)
    return np.where((r < radius) & (r > radius - rng.uniform(0.8, 1.5)), 0, BESIDE)


def ball(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    radius = rng.uniform(2, 5)
    inside = radius**2 - x**2 - y**2
    return np.where(inside > 0, np.sqrt(np.maximum(inside, 0)) - radius, BESIDE)


def screw(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    """A disc with one slot across."""
    slot = abs(y) < rng.uniform(0.3, 0.6)
    return np.where((np.hypot(x, y) < rng.uniform(2.5, 4)) & ~slot, 0, BESIDE)


def dome(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    """A rivet's head: the cap of a ball, flat on top as often as not."""
    radius, rise = rng.uniform(2, 4), rng.uniform(0.8, 1.8)
    cap = -rise * (np.hypot(x, y) / radius) ** 2
    flat = rng.choice([0.0, rng.uniform(0.1, 0.5)])
    return np.where(np.hypot(x, y) < radius, np.minimum(cap + flat, 0), BESIDE)


def torus(rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
    radius, wire = rng.uniform(1.5, 3.5), rng.uniform(0.5, 1.2)
    inside = wire**2 - (np.hypot(x, y) - radius) ** 2
    return np.where(inside > 0, np.sqrt(np.maximum(inside, 0)) - wire, BESIDE)


SNAPS: dict[str, Callable] = {"A": hook, "B": stud}
OTHERS: list[Callable] = [block, disc, tube, ball, screw]


@dataclass(frozen=True)
class Kinds:
    """What there is to draw, and how far apart."""

    snaps: dict[str, Callable]
    directed: set[str]
    others: list[Callable]
    free_mm: float = FREE_MM
    margin_mm: float = MARGIN_MM


BUILT_IN = Kinds(SNAPS, {"A"}, OTHERS)

# What scenes draw in place of it.
BUILT_IN_OF = {
    "small": Kinds(
        {
            "A": partial(hook, length_mm=(3.5, 5), width_mm=(1.6, 2.6), undercut_mm=(0.3, 0.6), top_mm=(0.1, 0.4)),
            "B": partial(stud, radius_mm=(1.75, 2.5), bead_mm=(0.2, 0.35), wall_mm=(0.5, 0.8)),
        },
        {"A"},
        OTHERS,
    ),
    "barbs": Kinds({"A": partial(hook, undercut_mm=(0.4, 1.2), lead_in_deg=(15, 50), top_mm=(0.1, 1.5), shaped=True), "B": stud}, {"A"}, OTHERS),
    "round": Kinds(SNAPS, {"A"}, [ball, disc, dome, torus, tube]),
}


@dataclass(frozen=True)
class Relief:
    """A part as a map of its heights, 0 at the highest; x to the right and y down from its middle, yaw 0 as it lies in the map."""

    heights: Plane
    mm: float
    least_mm: float = PRESSED[0]  # depth of a press

    def __call__(self, rng: np.random.Generator, x: Plane, y: Plane) -> Plane:
        rows, columns = (v / self.mm + side / 2 - 0.5 for v, side in zip((y, x), self.heights.shape))
        return map_coordinates(self.heights, [rows, columns], order=1, cval=BESIDE)

    def reach_mm(self) -> float:
        """Radius about its middle."""
        return float(np.hypot(*self.heights.shape)) * self.mm / 2

    def look_alikes(self) -> list["Relief"]:
        """A block of the outline, unless it looks the same, and the part without the third that its zero points to, pressed so deep that what it lacks would touch."""
        block = np.where(self.heights >= -DEEPEST_MM, 0, BESIDE)
        same = abs(block - self.heights)[self.heights > -DEEPEST_MM].max() <= 0.02
        end = max(1, round(self.heights.shape[1] * 2 / 3))
        cut, lost = np.split(self.heights, [end], axis=1)
        # A tilt may lift that end.
        least = -float(lost.max(initial=BESIDE)) + np.tan(np.radians(TILT_DEG)) * self.reach_mm() + 0.1
        broken = Relief(np.where(cut > BESIDE, cut - cut.max(), BESIDE), self.mm, min(max(PRESSED[0], least), PRESSED[1]))
        return [*([] if same else [Relief(block, self.mm)]), broken]

    @staticmethod
    def read(text: str) -> "Relief":
        """Of FILE:MM_PER_PIXEL:MM_AT_WHITE. Raises `ValueError`."""
        file, *numbers = text.rsplit(":", 2)
        mm, white = map(float, numbers) if len(numbers) == 2 else (0.0, 0.0)
        if not (0 < mm <= 1 and 0 < white <= 100):
            raise ValueError(f"expected FILE:MM_PER_PIXEL:MM_AT_WHITE, got {text}")
        with Image.open(file) as image:
            if not image.mode.startswith("I;16"):
                raise ValueError(f"{file}: expected a grey PNG of 16 bits, got {image.mode}")
            levels = np.asarray(image)
        there = levels > 0
        if not there.any():
            raise ValueError(f"{file}: expected a height map that shows a part, got one that is black")
        rows, columns = (slice(v.min(), v.max() + 1) for v in np.nonzero(there))
        levels, there = levels[rows, columns], there[rows, columns]
        return Relief(np.where(there, (levels - float(levels.max())) / 65535 * white, BESIDE), mm)


def own(parts: dict[str, Relief], undirected: set[str]) -> Kinds:
    """Such parts as classes, and what is not one of them."""
    alike = [other for part in parts.values() for other in part.look_alikes()]
    reach = max(part.reach_mm() for part in parts.values())
    return Kinds({**parts}, set(parts) - undirected, [*OTHERS, hook, stud, *alike], max(FREE_MM, 2 * reach), max(MARGIN_MM, reach))


def pressed(depth: Plane, mm: float, skin_mm: float) -> Plane:
    """The gel's depth where parts reach this deep: it keeps to them, and falls off beside them by Gaussians."""
    contact, gel = depth > 0, depth
    for width in (1.2, 0.6, 0.3, 0.12):
        gel = np.where(contact, depth, gaussian_filter(gel, width / mm))
    return gaussian_filter(gel, skin_mm / mm)


def lit(look: str, gel: Plane, mm: float, rng: np.random.Generator) -> Plane:
    """The picture `[height][width][3]`, in levels."""
    gy, gx = np.gradient(gel, mm)
    nz = 1 / np.sqrt(1 + gx**2 + gy**2)
    normal = np.stack([gx * nz, gy * nz, nz], -1)
    flat = rng.uniform(60, 150, 3)
    azimuth = rng.uniform(0, 2 * np.pi)

    def facing(angle: float, degrees: float) -> tuple[Plane, float]:
        elevation = np.radians(degrees)
        ray = np.array([np.cos(angle) * np.cos(elevation), np.sin(angle) * np.cos(elevation), np.sin(elevation)])
        return normal @ ray, ray[2]

    if look == "normals":
        return 128 + np.stack([90 * normal[..., 0], 90 * normal[..., 1], 40 * (1 - nz)], -1)[..., rng.permutation(3)]
    if look == "coat":
        return np.repeat((1.1 * flat[0] * np.exp(-rng.uniform(0.3, 1.2) * np.maximum(gel, 0)))[..., None], 3, -1)
    if look == "depth":
        share = 1 - 0.35 * np.clip(gel / 1.5, 0, 1) - 0.5 * (1 - nz)
        return 1.3 * flat * share[..., None]
    if look == "white":
        towards, up = facing(azimuth, 30)
        return np.repeat((flat[0] * (0.5 + 0.5 * np.maximum(towards, 0) / up))[..., None], 3, -1)
    picture = np.zeros((*gel.shape, 3))
    for channel in range(3):
        towards, up = facing(azimuth + channel * 2 * np.pi / 3, rng.uniform(20, 45))
        diffuse = np.maximum(towards, 0) / up
        highlight = 0.3 * (np.maximum(2 * towards * nz - up, 0) ** 8 - up**8)
        picture[..., channel] += flat[channel] * (0.4 + 0.6 * diffuse + highlight)
        picture[..., (channel + 1) % 3] += 0.15 * flat[channel] * (diffuse - 1)
    return picture


def printed(picture: Plane, gel: Plane, mm: float, rng: np.random.Generator) -> Plane:
    """Dark dots on a grid, moved down the gel's slopes."""
    pitch, diameter, turn = rng.uniform(1.8, 3), rng.uniform(0.4, 0.8), rng.uniform(-0.1, 0.1)
    gy, gx = np.gradient(gaussian_filter(gel, 1 / mm), mm)
    y, x = np.indices(gel.shape) * mm - 0.4 * np.stack([gy, gx])
    along, across = turned(x, y, turn)
    from_dot = np.hypot(along / pitch % 1 - 0.5, across / pitch % 1 - 0.5) * pitch
    return picture * (1 - 0.85 * gaussian_filter((from_dot < diameter / 2) * 1.0, 0.7))[..., None]


@dataclass(frozen=True)
class Placed:
    """A part of a kind, or another thing, how far it reaches into the gel, in mm, and its wall."""

    kind: str | None
    yaw: float
    reach: Plane
    wall: Plane | None = None

    def contact(self) -> Plane:
        return self.reach > 0.03

    def label(self, kinds: Kinds) -> list[dict]:
        """None of what does not touch the gel, or is no snap."""
        rows, columns = np.nonzero(self.contact())
        if not self.kind or not len(rows):
            return []
        left, top = int(columns.min()), int(rows.min())
        box = [left, top, int(columns.max()) + 1 - left, int(rows.max()) + 1 - top]
        yaw_deg = float(np.degrees(self.yaw)) if self.kind in kinds.directed else None
        return [{"category_id": list(kinds.snaps).index(self.kind) + 1, "bbox": box, "area": box[2] * box[3], "iscrowd": 0, "yaw_deg": yaw_deg}]


def place(rng: np.random.Generator, scene: str, kinds: Kinds, snap_share: float, dx: Plane, dy: Plane) -> Placed:
    """A thing at random, of positions from its middle."""
    kind = rng.choice(list(kinds.snaps)) if snap_share and rng.random() < snap_share else None
    part = kinds.snaps[kind] if kind else kinds.others[rng.integers(len(kinds.others))]
    yaw = rng.uniform(-np.pi, np.pi)
    tilt = np.tan(np.radians(rng.uniform(-TILT_DEG, TILT_DEG, 2)))
    along, across = turned(dx, dy, yaw)
    relief = part(rng, along, across)
    least, most = part.least_mm if isinstance(part, Relief) else PRESSED[0], PRESSED[1]
    press = rng.uniform(least, most) + dx * tilt[0] + dy * tilt[1]
    grown = kind == "A" and scene == "wall"
    return Placed(kind, yaw, relief + press, wall(rng, along, across, along[relief > BESIDE].min()) + press if grown else None)


def apart(rng: np.random.Generator, scene: str, kinds: Kinds, x: Plane, y: Plane, half: Plane) -> list[Placed]:
    """One to three things that are far from each other."""
    middles, parts = [], []
    for _ in range(rng.integers(1, 4)):
        middle = rng.uniform(-1, 1, 2) * np.maximum(half - kinds.margin_mm, 0)
        if any(np.hypot(*(middle - other)) < kinds.free_mm for other in middles):
            continue
        middles.append(middle)
        parts.append(place(rng, scene, kinds, 0 if scene in WITHOUT_SNAPS else 0.6, x - middle[0], y - middle[1]))
    return parts


def pair(rng: np.random.Generator, scene: str, kinds: Kinds, x: Plane, y: Plane, half: Plane, mm: float) -> list[Placed]:
    """Two snaps whose contacts lie `GAP_MM` apart, both within the picture."""
    while True:
        gap, angle = rng.uniform(*GAP_MM), rng.uniform(-np.pi, np.pi)
        towards = np.array([np.cos(angle), np.sin(angle)])
        middle = rng.uniform(-1, 1, 2) * np.maximum(half - 2 * kinds.margin_mm, 0) - towards * kinds.margin_mm * 0.7
        first = place(rng, scene, kinds, 1, x - middle[0], y - middle[1])
        free = distance_transform_edt(~first.contact()) * mm
        middle, shape = middle + towards * kinds.free_mm, rng.integers(2**32)
        # It moves in by what lies between the two, which never takes it too far.
        for _ in range(15):
            second = place(np.random.default_rng(shape), scene, kinds, 1, x - middle[0], y - middle[1])
            between = free[second.contact()].min(initial=free.max())
            middle = middle - towards * (between - gap)
        contacts = first.contact() | second.contact()
        edge = contacts[[0, -1]].any() or contacts[:, [0, -1]].any()
        if first.contact().any() and second.contact().any() and not edge and abs(between - gap) < 2 * mm:
            return [first, second]


def draw(look: str, scene: str, rng: np.random.Generator, kinds: Kinds = BUILT_IN) -> tuple[Plane, list[dict]]:
    """A picture with its labels."""
    mm, width, height = LOOKS[look]
    half = np.array([width, height]) * mm / 2
    x, y = np.meshgrid((np.arange(width) + 0.5) * mm - half[0], (np.arange(height) + 0.5) * mm - half[1])
    parts = pair(rng, scene, kinds, x, y, half, mm) if scene == "pairs" else apart(rng, scene, kinds, x, y, half)
    depth = np.zeros((height, width))
    for part in parts:
        depth = np.maximum(depth, part.reach if part.wall is None else np.maximum(part.reach, part.wall))
    labels = [label for part in parts for label in part.label(kinds)]
    gel = pressed(depth, mm, 0.2 if look == "soft" else 0.08)
    picture = lit(look, gel, mm, rng)
    if scene == "round":
        edge = np.minimum(distance_transform_edt(depth > 0), distance_transform_edt(depth <= 0)) * mm
        picture = picture * (1 + rng.uniform(-0.5, 1) * np.exp(-((edge / rng.uniform(0.15, 0.5)) ** 2)))[..., None]
    if scene == "markers":
        picture = printed(picture, gel, mm, rng)
    if look != "normals":
        slope = rng.uniform(-0.25, 0.25, 2)
        picture *= (1 + slope[0] * x / half[0] + slope[1] * y / half[1])[..., None]
    picture = gaussian_filter(picture, (0.6, 0.6, 0)) + rng.normal(0, 1.5, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8), labels


def write(folder: Path, look: str, scene: str, count: int, rng: np.random.Generator, kinds: Kinds) -> None:
    mm, width, height = LOOKS[look]
    (folder / "images").mkdir(parents=True)
    images, annotations = [], []
    for i in range(count):
        picture, labels = draw(look, scene, rng, kinds)
        name = f"{i:06}.png"
        Image.fromarray(picture).save(folder / "images" / name)
        images.append({"id": i, "file_name": name, "width": width, "height": height, "mm_per_pixel": mm})
        annotations += [{"id": len(annotations) + k, "image_id": i, **label} for k, label in enumerate(labels)]
    categories = [{"id": i + 1, "name": kind} for i, kind in enumerate(kinds.snaps)]
    (folder / "annotations.json").write_text(json.dumps({"categories": categories, "images": images, "annotations": annotations}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="a folder that is not there yet")
    parser.add_argument("--count", type=int, default=100, help="pictures of each look and scene; without snaps half as many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--look", nargs="+", choices=LOOKS, default=[*LOOKS], help="these alone")
    parser.add_argument("--scene", nargs="+", choices=SCENES, default=[*SCENES], help="these alone")
    parser.add_argument("--part", action="append", default=[], metavar="NAME=MAP.png:MM_PER_PIXEL:MM_AT_WHITE", help="a class that is a height map, several times for several")
    parser.add_argument("--undirected", nargs="*", default=[], metavar="NAME", help="parts without a direction: those that look the same after some turn")
    args = parser.parse_args()
    kinds = None
    if args.part:
        try:
            parts = {name: Relief.read(text) for name, _, text in (part.partition("=") for part in args.part)}
            if len(parts) < len(args.part) or not set(args.undirected) <= parts.keys():
                raise ValueError(f"expected each name once, and --undirected of these, got {', '.join(args.part)}")
            kinds = own(parts, set(args.undirected))
        except (OSError, ValueError) as error:
            sys.exit(f"--part: {error}")
    args.out.mkdir(parents=True)
    for number, look in enumerate(LOOKS):
        for scene_number, scene in enumerate(SCENES):
            if look not in args.look or scene not in args.scene or (args.part and scene in ("wall", *BUILT_IN_OF)):
                continue
            rng = np.random.default_rng([args.seed, number, scene_number])
            count = args.count // 2 if scene in WITHOUT_SNAPS else args.count
            write(args.out / f"{look}-{scene}", look, scene, count, rng, kinds or BUILT_IN_OF.get(scene, BUILT_IN))


if __name__ == "__main__":
    main()
