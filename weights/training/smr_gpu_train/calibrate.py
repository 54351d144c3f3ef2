"""Fits the scores and the stated deviations to pictures with labels, and writes them into a copy of the weight file.

The temperature divides the class logits; with it goes an offset of each logit but the last
class's, into the biases. They are those under which the scores of the detections that there
are before say best how often they are right (least log loss; right: right class, overlap of
at least half, each snap once). A deviation s of yaw or of the centre becomes c s^k, with c
and k such that 68.3 % of the errors lie within one of them, among small and large ones
alike: a log variance is an output of roi_head.pose, so k scales its row and 2 ln c goes
into its bias. All scales are looked at, as programs do unasked. `--data` decides the
scores, but with `--keep-scores`; the deviations learn from `--deviations` too.
Figures before and after are printed, after on the same pictures: others must judge them.
"""

import argparse
import math
from collections.abc import Sequence

import numpy as np
import torch

from . import weightfile
from .data import network_input, normalise
from .evaluate import read
from .metrics import calibration_error, right
from .model import Heads, SmrNet, classify, survivors
from .pictures import Entry

SHARE = math.erf(math.sqrt(0.5))  # of a normal distribution within one deviation


class Looks:
    """Each picture's regions as the head sees them, and its truth in input pixels."""

    def __init__(self, model: SmrNet, pictures: Sequence[Entry]):
        self.config = model.config
        self.rows: list[tuple[torch.Tensor, Heads, torch.Size, dict[str, torch.Tensor]]] = []
        for entry in pictures:
            pixels, (x, y) = network_input(entry.pixels(), self.config.pixels_per_mm * entry.mm_per_pixel)
            image = normalise(pixels, self.config.mean, self.config.std)[None].contiguous(memory_format=torch.channels_last)
            truth = {name: torch.from_numpy(getattr(entry.snaps, name)) for name in ("boxes", "labels", "yaw", "whole")}
            truth["boxes"] = truth["boxes"] / torch.tensor([x, y, x, y])
            proposals, heads = model.regions(image, {})[0]
            self.rows.append((proposals, heads, image.shape[2:], truth))

    def detections(self, temperature: float) -> list[tuple[dict, dict, torch.Tensor]]:
        """Truth, detections and which truth each of them finds."""
        self.config.temperature = temperature
        found = []
        for proposals, heads, size, truth in self.rows:
            detections = classify(self.config, heads, proposals, size, 0.05, 0.5)
            found.append((truth, detections, right(truth, detections)))
        return found

    def scores(self, temperature: float) -> tuple[np.ndarray, np.ndarray]:
        """Scores and whether they are right, of all detections."""
        found = self.detections(temperature)
        return np.concatenate([d["scores"].numpy() for _, d, _ in found]), np.concatenate([(f >= 0).numpy() for _, _, f in found])

    def logits(self) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        """Of all detections at temperature 1: the class logits [D, classes + 1], the label [D], whether it is right [D]."""
        self.config.temperature = 1.0
        rows = []
        for proposals, heads, size, truth in self.rows:
            found = survivors(self.config, heads, proposals, size, 0.05, 0.5)
            hits = right(truth, {"boxes": found.boxes, "scores": found.scores, "labels": found.labels}) >= 0
            rows.append((heads.scores[found.rows], found.labels, hits))
        logits, labels, hits = (torch.cat(parts) for parts in zip(*rows))
        return logits, labels, hits.numpy()


def log_loss(scores: np.ndarray, hits: np.ndarray) -> float:
    p = scores.astype(np.float64).clip(1e-6, 1 - 1e-6)
    return float(-np.where(hits, np.log(p), np.log(1 - p)).mean())


def fit_scores(logits: torch.Tensor, labels: torch.Tensor, hits: np.ndarray) -> tuple[float, torch.Tensor]:
    """The temperature and each logit's offset [classes + 1] of least log loss; the last class's offset is 0."""
    found = torch.from_numpy(hits).double()
    free = torch.zeros(logits.shape[1], dtype=torch.float64, requires_grad=True)  # offsets, then ln temperature

    def shifted() -> tuple[torch.Tensor, torch.Tensor]:
        return free[-1].exp(), torch.cat([free[:-1], free.new_zeros(1)])

    optimizer = torch.optim.LBFGS([free], max_iter=200, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        temperature, offsets = shifted()
        score = ((logits.double() + offsets) / temperature).softmax(dim=1).gather(1, labels[:, None])[:, 0]
        loss = torch.nn.functional.binary_cross_entropy(score.clamp(1e-6, 1 - 1e-6), found)
        loss.backward()
        return loss

    optimizer.step(closure)
    temperature, offsets = shifted()
    return float(temperature), offsets.detach().float()


def errors(looks: Looks, temperature: float) -> dict[str, np.ndarray]:
    """Stated deviations and |errors|, [2, N]: of whole snaps' yaw, of the centre along x and y; detections above a half that are right."""
    pairs: dict[str, list] = {"yaw": [], "x": [], "y": []}
    for truth, detections, found in looks.detections(temperature):
        for i in torch.where((found >= 0) & (detections["scores"] >= 0.5))[0].tolist():
            j = int(found[i])
            shift = (detections["boxes"][i, :2] + detections["boxes"][i, 2:] - truth["boxes"][j, :2] - truth["boxes"][j, 2:]).abs() / 2
            for axis, name in enumerate("xy"):
                pairs[name].append((float(detections["centre_std"][i, axis]), float(shift[axis] / looks.config.pixels_per_mm)))
            if truth["whole"][j] and truth["yaw"][j].isfinite() and detections["yaw"][i].isfinite():
                turn = (float(detections["yaw"][i]) - float(truth["yaw"][j].rad2deg()) + 180) % 360 - 180
                pairs["yaw"].append((float(detections["yaw_std"][i]), abs(turn)))
    return {k: np.array(v).reshape(-1, 2).T for k, v in pairs.items()}


def fit_deviations(stated: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """The k and ln c under which SHARE of the errors lie within c stated^k, whatever is stated.

    For each k, ln c is a quantile of ln |error| - k ln stated. Of k in steps of 0.01 the one that
    leaves the thirds by stated deviation most alike: a quantile regression weighs errors by their
    size, and may leave too few within it in the third with the smallest deviations.
    """
    stated, error = np.log(stated), np.log(np.maximum(error, 1e-6))

    def fit(k: float) -> tuple[float, float, float]:
        rest = error - k * stated
        shift = float(np.quantile(rest, SHARE))
        return sum((share - SHARE) ** 2 for share in thirds(k * stated + shift, error)), k, shift

    _, k, shift = min(fit(k) for k in np.arange(30, 171) / 100)
    return float(k), shift


def thirds(stated: np.ndarray, error: np.ndarray) -> list[float]:
    """Shares of the errors within one deviation, by thirds of what is stated; of both also the logarithms."""
    within = error <= stated
    return [float(part.mean()) for part in np.array_split(within[np.argsort(stated)], 3)]


def shares(stated: np.ndarray, error: np.ndarray) -> str:
    """The shares of all and of the thirds, for people."""
    parts = [(error <= stated).mean(), *thirds(stated, error)]
    return "{:.0f} % ({:.0f}, {:.0f}, {:.0f})".format(*(100 * p for p in parts))


def calibrate_scores(model: SmrNet, looks: Looks) -> float:
    """Puts the offsets into the model and into the looks; returns the temperature."""
    scores, hits = looks.scores(1.0)
    print(f"before: {len(scores)} detections, log loss {log_loss(scores, hits):.4f}, calibration error {calibration_error(scores, hits):.4f}")
    temperature, offsets = fit_scores(*looks.logits())
    best = round(temperature, 3)
    for _, heads, _, _ in looks.rows:
        heads.scores = heads.scores + offsets
    with torch.no_grad():
        model.roi_head.cls_score.bias.add_(offsets)
    scores, hits = looks.scores(best)
    print(f"after: temperature {best}, offsets {[round(o, 3) for o in offsets.tolist()]}, {len(scores)} detections, log loss {log_loss(scores, hits):.4f}, calibration error {calibration_error(scores, hits):.4f}")
    return best


LEAST = 60  # errors, or right and wrong detections, to fit anything to


def run(args: argparse.Namespace) -> int:
    model = weightfile.load(args.weights)
    folders = read("--data", args.data, model.config, args, args.split)
    further = read("--deviations", args.deviations, model.config, args) if args.deviations else {}
    looks = Looks(model, [entry for entries in folders.values() for entry in entries])
    best = model.config.temperature
    if not args.keep_scores:
        hits = looks.scores(1.0)[1]
        if min(hits.sum(), (~hits).sum()) < LEAST:
            print(f"scores: expected at least {LEAST} right and {LEAST} wrong detections, got {hits.sum()} and {(~hits).sum()}: left as they are")
        else:
            best = calibrate_scores(model, looks)
    layer = model.roi_head.pose
    if layer is not None:
        more = Looks(model, [entry for entries in further.values() for entry in entries])
        found = [errors(each, best) for each in (looks, more)]
        for name, output in {"yaw": 2, "x": 3, "y": 4}.items():
            stated, error = np.concatenate([pairs[name] for pairs in found], axis=1)
            if len(stated) < LEAST:
                print(f"{name}: expected at least {LEAST} errors, got {len(stated)}: left as it is")
                continue
            k, shift = fit_deviations(stated, error)
            # The unit of the variance that the row states is rad² or mm².
            unit = math.radians(1) if name == "yaw" else 1.0
            after = shares(np.exp(shift) * stated**k, error)
            print(f"{name}: {len(stated)} errors, within one stated deviation {shares(stated, error)}; {math.exp(shift):.3f} s^{k}: {after}")
            with torch.no_grad():
                layer.weight[output] *= k
                bias = layer.bias
                bias[output] = k * bias[output] + 2 * (shift + (1 - k) * math.log(unit))
    model.config.temperature = best
    weightfile.save(model, args.out)
    print(args.out)
    return 0
