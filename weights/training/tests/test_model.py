"""The quick forms used in training against their definitions. `python test_model.py`"""

import json
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torchvision import ops
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection._utils import BoxCoder, Matcher
from torchvision.models.detection.image_list import ImageList

from smr_gpu_train import boxes as bx
from smr_gpu_train import pose, weightfile
from smr_gpu_train.calibrate import SHARE, fit_deviations
from smr_gpu_train.config import NETWORKS, Config
from smr_gpu_train.data import network_input, normalise, resize_square
from smr_gpu_train.errors import Failure
from smr_gpu_train.gates import PoolChannels, PoolSpace, ScaleChannels, ScaleSpace
from smr_gpu_train.learner import Learner
from smr_gpu_train.losses import Rois, match_anchors, pose_losses, roi_loss, sample_rois
from smr_gpu_train.metrics import calibration_error, right
from smr_gpu_train.model import Heads, SmrNet, classify, propose, propose_batch, vote
from smr_gpu_train.pictures import read_picture
from smr_gpu_train.truth import Truth
from torch import nn

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "weights/training"))

from count import multiply_adds, stored_bytes  # noqa: E402


def random_model(config: Config, seed: int) -> SmrNet:
    """Random weights with batch norm statistics that keep the activations in range."""
    torch.manual_seed(seed)
    model = SmrNet(config).to(memory_format=torch.channels_last)
    for m in model.modules():
        if isinstance(m, nn.BatchNorm2d):
            nn.init.uniform_(m.weight, 0.5, 1.0)
            m.momentum = None
    model.train()
    with torch.no_grad():
        model.features(torch.randn(4, 3, 320, 320).contiguous(memory_format=torch.channels_last), {})
        # Spread the scores, so that proposals and detections are not all alike.
        model.rpn.cls.weight.mul_(20)
        model.roi_head.cls_score.weight.mul_(20)
        model.roi_head.bbox_pred.weight.mul_(20)
    return model.eval()


def same(name: str, got: torch.Tensor, truth: torch.Tensor, bound: float = 1e-10) -> None:
    assert got.shape == truth.shape, f"{name}: {got.shape}, expected {truth.shape}"
    error = (got - truth).abs().max().item()
    assert error <= bound, f"{name}: {error} > {bound}"
    print(f"ok {name}: {error:.1e}")


def gates() -> None:
    x = torch.randn(2, 6, 5, 7, dtype=torch.float64).contiguous(memory_format=torch.channels_last)
    channel, space = torch.rand(2, 6, dtype=torch.float64), torch.rand(2, 1, 5, 7, dtype=torch.float64)
    cases = [
        ("PoolSpace", PoolSpace, (x,), lambda x: torch.stack([x.mean((2, 3)), x.amax((2, 3))])),
        ("PoolChannels", PoolChannels, (x,), lambda x: torch.cat([x.amax(1, True), x.mean(1, True)], 1)),
        ("ScaleChannels", ScaleChannels, (x, channel), lambda x, g: x * g[:, :, None, None]),
        ("ScaleSpace", ScaleSpace, (x, space), lambda x, g: x * g),
    ]
    for name, quick, inputs, plain in cases:
        inputs = tuple(i.requires_grad_() for i in inputs)
        got, truth = quick.apply(*inputs), plain(*inputs)
        same(name, got, truth)
        weight = torch.randn_like(truth)
        pairs = zip(torch.autograd.grad(got, inputs, weight), torch.autograd.grad(truth, inputs, weight))
        for i, (a, b) in enumerate(pairs):
            same(f"{name}, gradient of input {i}", a, b)


def roi_align() -> None:
    # Inside, partly outside, wholly outside, tiny; float32 sampling weights give the bound.
    features = torch.randn(2, 5, 24, 20, requires_grad=True)
    boxes = torch.tensor([[[3.0, 5, 60, 90], [-5, -3, 20, 200]], [[300, 10, 320, 40], [10, 10, 11, 12]]])
    got, truth = bx.roi_align_dense(features, boxes, 1 / 8), ops.roi_align(features, [*boxes], 7, 1 / 8, 2, aligned=True)
    same("roi_align_dense", got, truth, 2e-5)
    weight = torch.randn_like(truth)
    same("roi_align_dense, gradient", *(torch.autograd.grad(o, features, weight)[0] for o in (got, truth)), 2e-4)


def anchors_and_coder() -> None:
    sizes, ratios = [31.0, 45.0, 70.0], [0.61, 1.0, 1.64]
    generator = AnchorGenerator((tuple(sizes),), (tuple(ratios),))
    truth = generator(ImageList(torch.zeros(1, 3, 96, 64), [(96, 64)]), [torch.zeros(1, 1, 12, 8)])[0]
    got = bx.grid_anchors(bx.cell_anchors(sizes, ratios), 12, 8, 8)
    same("anchors", got, truth.double(), 0.0)
    deltas = torch.randn(len(truth), 4) * torch.tensor([1.0, 1, 2, 3])
    coder = BoxCoder(bx.ROI_WEIGHTS)
    same("decode", bx.decode(deltas, truth, bx.ROI_WEIGHTS), coder.decode_single(deltas, truth), 1e-3)
    target = bx.decode(deltas / 4, truth, bx.RPN_WEIGHTS)
    same("encode", bx.encode(target, truth, bx.RPN_WEIGHTS), BoxCoder(bx.RPN_WEIGHTS).encode_single(target, truth), 1e-5)


def boxes_of_a_batch(generator: torch.Generator, *shape: int) -> torch.Tensor:
    corner, side = (torch.rand(*shape, 2, generator=generator) * scale for scale in (100, 60))
    return torch.cat([corner, corner + side + 2], dim=-1)


def batches() -> None:
    """What the losses do for a batch at once against torchvision, picture by picture."""
    generator = torch.Generator().manual_seed(3)
    a, b = boxes_of_a_batch(generator, 3, 40), boxes_of_a_batch(generator, 3, 5)
    for i, overlap in enumerate(bx.iou(a, b)):
        same(f"IoU of picture {i}", overlap, ops.box_iou(a[i], b[i]), 1e-6)

    anchors = bx.grid_anchors(bx.cell_anchors([24.0, 40.0], [0.5, 1.0, 2.0]), 16, 20, 8).float()
    logits = torch.randn(4, len(anchors), generator=generator)
    deltas = 0.3 * torch.randn(4, len(anchors), 4, generator=generator)
    deltas[3, :, 2:] = -12.0  # boxes with nothing in them
    boxes, there = propose_batch(logits, deltas, anchors, (128, 160), 200, 50)
    for i in range(4):
        alone, _ = propose(logits[i], deltas[i], anchors, (128, 160), 200, 50)
        got = boxes[i][there[i]]
        assert torch.equal(got, alone), f"proposals of picture {i}: {len(got)}, alone {len(alone)}"
    print("ok proposals of a batch are those of its pictures alone")

    labels = torch.tensor([[1, 2, 0], [0, 0, 0], [2, 1, 1], [1, 0, 0]])
    nan = math.nan
    truth = Truth(boxes_of_a_batch(generator, 4, 3), labels, torch.full((4, 3), nan), torch.ones(4, 3), boxes_of_a_batch(generator, 4, 1))
    truth.ignored[0] = 0
    positive, negative, which = match_anchors(anchors, truth)
    matcher = Matcher(0.7, 0.3, allow_low_quality_matches=False)
    for i in range(4):
        snaps = truth.boxes[i][labels[i] > 0]
        if not len(snaps):
            assert not positive[i].any()
            continue
        overlap = ops.box_iou(snaps, anchors)
        alone = matcher(overlap)
        # Low-quality matches: nearly each truth's best, not the best alone.
        low = (overlap >= 0.9 * overlap.amax(dim=1, keepdim=True)).any(dim=0)
        assert torch.equal(positive[i], (alone >= 0) | low)
        assert torch.equal(which[i][positive[i]], overlap.argmax(dim=0)[positive[i]])
        shared = torch.maximum(anchors[:, :2], truth.ignored[i, :, :2]), torch.minimum(anchors[:, 2:], truth.ignored[i, :, 2:])
        on_ignored = (shared[1] - shared[0]).clamp(min=0).prod(dim=1) > 0.2 * (anchors[:, 2:] - anchors[:, :2]).prod(dim=1)
        assert torch.equal(negative[i], (alone == -1) & ~low & ~on_ignored)
    print("ok anchors and their truth, as torchvision's Matcher has them")

    rois = sample_rois(boxes, there, truth)
    for i in range(4):
        snaps = truth.boxes[i][labels[i] > 0]
        used = rois.labels[i] >= 0
        best = ops.box_iou(rois.boxes[i][used], snaps).amax(dim=1) if len(snaps) else torch.zeros(int(used.sum()))
        assert ((rois.labels[i][used] > 0) == (best >= 0.5)).all(), "positive from an overlap of half on"
        assert (rois.labels[i] > 0).sum() <= 16 and (best[best < 0.5] < 0.4).all()
        # A truth is a region of its own, and of no truth there is none.
        assert (rois.labels[i][~rois.proposed[i] & used] > 0).all()
        distinct = rois.boxes[i][used].unique(dim=0)
        assert len(distinct) == used.sum(), "a region comes once"
    best_first = boxes[1][there[1]][~on_ignored_boxes(boxes[1][there[1]], truth.ignored[1])]
    assert torch.equal(rois.boxes[1][rois.labels[1] == 0], best_first[:64]), "without a snap, the best proposals"
    print("ok regions: a quarter positive, none twice")


def on_ignored_boxes(boxes: torch.Tensor, ignored: torch.Tensor) -> torch.Tensor:
    return bx.intersection(boxes[None], ignored[None])[0].amax(dim=1) > 0.2 * bx.area(boxes)


def losses_by_hand() -> None:
    """Two regions of one picture, one of class 2, and a row that is no region at all."""
    heads = Heads(torch.tensor([[0.0, 0, 0], [0, 0, math.log(2)], [9, -9, 9]]), torch.zeros(3, 12), torch.zeros(3, 6))
    heads.regression[1, 8:] = torch.tensor([1.0, 0, 0, 0])
    box = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 10], [0, 0, 1, 1]])
    moved = box + torch.tensor([[0.0], [1.0], [0.0]])
    rois = Rois(box, torch.tensor([0, 2, -1]), moved, torch.full((3,), math.nan), torch.tensor([1.0, 0, 1]), torch.tensor([True] * 3))
    classes, boxes = roi_loss(heads, rois)
    same("class loss", classes, torch.tensor((math.log(3) + math.log(2)) / 2), 1e-6)
    # Deltas (1, 1, 0, 0) are wanted, (1, 0, 0, 0) are said: one is wrong by 1, over two regions.
    same("box loss", boxes, torch.tensor((1 - 0.5 / 9) / 2), 1e-6)
    found = pose_losses(heads, heads.pose, rois, 8.0)
    # The centre is said to be at (6, 5), it is at (6, 6): wrong by 1/8 mm along y, at variances of 1.
    same("centre's loss", found["centre"], torch.tensor(0.5 / 64), 1e-7)
    same("yaw's loss of nothing with a direction", found["yaw"], torch.tensor(0.0), 0.0)
    same("whole's loss", found["whole"], torch.tensor(math.log(2)), 1e-6)


def steps() -> None:
    """A gradient that is not finite teaches nothing, and does no harm to the next."""
    learner = Learner(Config(**NETWORKS["small"]), "cpu", weight_decay=0.1)
    weight = learner.model.rpn.cls.weight
    for factor in (1.0, math.nan, 1.0):
        before = weight.detach().clone()
        norm = learner.learn((weight * factor).sum(), 1e-3)
        moved = not torch.equal(weight, before)
        assert moved == math.isfinite(factor) == bool(norm.isfinite()) and weight.isfinite().all(), factor
    print("ok steps without a finite gradient are left out")


def frames() -> None:
    # 320 x 240 at 0.0634 mm: 20.3 x 15.2 mm, 162 x 122 pixels at 8 a millimetre, in 192 x 128.
    frame = np.arange(240 * 320 * 3, dtype=np.uint64).reshape(240, 320, 3).astype(np.uint8)
    pixels, (x, y) = network_input(frame, 8 * 0.0634)
    assert pixels.shape == (3, 128, 192) and (x, y) == (320 / 162, 240 / 122)
    assert (pixels[:, :, 162:] == pixels[:, :, 161:162]).all() and (pixels[:, 122:] == pixels[:, 121:122]).all()
    # The paper's frame is its square, to the bit.
    paper = np.random.default_rng(0).integers(0, 256, (1000, 1000, 3), dtype=np.uint8)
    assert torch.equal(network_input(paper, 8 * 0.04)[0], resize_square(paper, 320)[0])
    print("ok frames: 2")


def pose_decoding() -> None:
    # A direction of (0, 2): straight down. Log variances: ln(0.01) rad^2 is 0.1 rad; 0 and ln(4) mm^2 are 1 and 2 mm; logit ln 3 is 3/4.
    row = [0.0, 2.0, math.log(0.01), 0.0, math.log(4), math.log(3)]
    # Past the bounds: a deviation of half a turn over the root of three, exp(-6) mm, 10 mm.
    wild = [-1.0, 0.0, 50.0, -50.0, 50.0, 0.0]
    found = pose.decode(torch.tensor([row, wild, row], dtype=torch.float64), torch.tensor([True, True, False]))
    same("yaw", found["yaw"][:2], torch.tensor([90.0, 180.0], dtype=torch.float64))
    same("yaw's deviation", found["yaw_std"][:2], torch.tensor([math.degrees(0.1), 180 / math.sqrt(3)], dtype=torch.float64))
    assert found["yaw"][2].isnan() and found["yaw_std"][2].isnan()
    same("centre's deviation", found["centre_std"][:2], torch.tensor([[1.0, 2.0], [math.exp(-6), 10.0]], dtype=torch.float64))
    same("whole", found["whole"], torch.tensor([0.75, 0.5, 0.75], dtype=torch.float64))


def pose_likelihoods() -> None:
    # The likelihood is least where the stated variance is the errors' own: the concentration's, and the mean square.
    torch.manual_seed(1)
    error = torch.randn(20000, dtype=torch.float64) * 0.3
    rows = torch.zeros(1, 6, dtype=torch.float64).repeat(len(error), 1)
    rows[:, 0] = 1
    grid = [math.log(0.09) + step for step in (-0.3, -0.1, 0.0, 0.1, 0.3)]

    def least(loss) -> int:
        values = []
        for s in grid:
            rows[:, 2:5] = s
            values.append(loss())
        return int(torch.stack(values).argmin())

    assert least(lambda: pose.centre_loss(rows, torch.stack([error, error], 1)).mean()) == 2
    # yaw_loss weighs by exp(s / 2), which is no part of the gradient; and its distance does not depend on s.
    distance = 0.5 * (2 - 2 * error.cos()).mean()
    assert least(lambda: (pose.yaw_loss(rows, error).mean() - distance) / (rows[0, 2] / 2).exp()) == 2
    print("ok likelihoods: 2")


def detections() -> None:
    config = Config(pose=True, temperature=2.0)
    # Two regions far apart; their boxes are the regions. Logits (0, 2 ln 8, 0) at temperature 2: 8 of 10.
    scores = torch.tensor([[0.0, 2 * math.log(8), 0.0], [0.0, 0.0, 2 * math.log(8)]])
    rows = torch.tensor([[1.0, 0, 0, 0, 0, 0], [1.0, 1, 0, 0, 0, 9]])
    proposals = torch.tensor([[0.0, 0, 40, 40], [100, 100, 160, 150]])
    found = classify(config, Heads(scores, torch.zeros(2, 12), rows), proposals, (200, 200), 0.5, 0.5)
    assert found["labels"].tolist() == [1, 2] and torch.equal(found["boxes"], proposals)
    same("score at a temperature", found["scores"], torch.tensor([0.8, 0.8]), 1e-6)
    # Scores of 1 in float32: of two boxes of a class of which one lies on the other, that of the higher logit stays.
    scores = torch.tensor([[0.0, 40.0, 0.0], [0.0, 42.0, 0.0]])
    twins = torch.tensor([[0.0, 0, 40, 40], [0, 0, 40, 41]])
    sure = classify(config, Heads(scores, torch.zeros(2, 12), rows), twins, (200, 200), 0.5, 0.5)
    # They share 40 of 41, so the other has less than its own vote.
    assert sure["scores"].tolist() == [1.0] and sure["boxes"][0, 3] > 40.5
    # The stud's yaw is nobody's; the pose's row follows its box.
    assert found["yaw"][0] == 0 and found["yaw"][1].isnan() and found["whole"][1] > 0.99 > found["whole"][0]


def voting() -> None:
    # 10 high. Of the first the second is 85 %: 0.8 * (0.85 - 0.7) / 0.3 = 0.4, its own vote 0.8. The third is of
    # another class, the fourth exactly 70 %, the last apart.
    ends = [(0.0, 20.0), (0, 17), (0, 20), (0, 14), (40, 50)]
    boxes = torch.tensor([[low, 0, high, 10] for low, high in ends], dtype=torch.float64)
    scores = torch.tensor([0.8, 0.8, 0.9, 0.9, 0.3], dtype=torch.float64)
    rows = torch.tensor([[1.0, 5], [4, 5], [100, 100], [100, 100], [7, 8]], dtype=torch.float64)
    found = vote(rows, boxes, scores, torch.tensor([1, 1, 2, 1, 1]), torch.tensor([0, 4]))
    same("box voting", found, torch.tensor([[2.0, 5], [7, 8]], dtype=torch.float64), 1e-12)


def calibration() -> None:
    # Scores of 0.9 of which 8 of 10 are right, and of 0.3 of which 1 of 10 is: (0.1 + 0.2) / 2.
    scores, hits = np.repeat([0.9, 0.3], 10), np.array([True] * 8 + [False] * 2 + [True] + [False] * 9)
    assert abs(calibration_error(scores, hits) - 0.15) < 1e-12
    truth = {"boxes": torch.tensor([[0.0, 0, 10, 10]]), "labels": torch.tensor([1])}
    # The best takes the snap, its double is wrong, the other class too.
    boxes = torch.tensor([[0.0, 0, 10, 9], [0, 0, 10, 10], [0, 0, 10, 10]])
    assert right(truth, {"boxes": boxes, "labels": torch.tensor([1, 1, 2])}).tolist() == [0, -1, -1]
    print("ok calibration: 2")


def deviations() -> None:
    # Normal errors whose deviation is 2 sqrt(stated): the fit finds the law, and with it each third is right.
    rng = np.random.default_rng(5)
    stated = np.exp(rng.uniform(-2, 2, 30_000))
    error = np.abs(rng.normal(0, 2 * np.sqrt(stated)))
    k, shift = fit_deviations(stated, error)
    assert abs(k - 0.5) <= 0.03 and abs(shift - math.log(2)) <= 0.03, (k, shift)
    within = (error <= math.exp(shift) * stated**k)[np.argsort(stated)]
    for third in np.array_split(within, 3):
        # 10 000 trials: four deviations are 0.019.
        assert abs(third.mean() - SHARE) <= 0.02, third.mean()
    print(f"ok deviations: 2 s^0.5, found {math.exp(shift):.2f} s^{k}")


def networks() -> None:
    large, small = (SmrNet(Config(pose=True, **NETWORKS[name])) for name in ("large", "small"))
    assert multiply_adds(small) * 8 <= multiply_adds(large), f"{multiply_adds(small)} of {multiply_adds(large)}"
    assert stored_bytes(small) <= 8_000_000, stored_bytes(small)
    print(f"ok small network: 1/{multiply_adds(large) / multiply_adds(small):.2f} of the multiply-adds, {stored_bytes(small) / 1e6:.2f} MB")


def weight_files() -> None:
    # Format 2: what was written is read.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "small.safetensors"
        model = random_model(Config(pose=True, temperature=1.3, **NETWORKS["small"]), 3)
        weightfile.save(model, file)
        again = weightfile.load(file)
        assert again.config == model.config and again.config.to_dict()["format"] == 2
        twice = Path(folder) / "twice.safetensors"
        weightfile.save(again, twice)
        assert file.read_bytes() == twice.read_bytes()
        # A format that nobody knows is refused.
        save_file({"x": torch.zeros(1)}, file, metadata={"config": json.dumps({**model.config.to_dict(), "format": 3})})
        try:
            weightfile.load(file)
            raise AssertionError("format 3 was read")
        except Failure as error:
            assert str(error) == f"{file}: format: expected 1 or 2, got 3"
    # What format 1 leaves unsaid.
    config = {"format": 1, "input_size": 320, "mean": [0.5] * 3, "std": [0.2] * 3, "classes": ["A", "B"], "anchor_sizes": [32.0]}
    config |= {"anchor_ratios": [1.0], "variant": {"safe": True, "msff": True, "rw": True}, "mm_per_pixel": 0.04, "picture_size": 1000, "reduction": 16}
    read = Config.from_dict(config)
    assert (read.pixels_per_mm, read.pose, read.temperature, read.channels, read.blocks) == (8.0, False, 1.0, [64, 128, 256, 512], [3, 4, 6, 3])
    # The published file against its golden tensors.
    golden = load_file(ROOT / "tests/fixtures/stages.safetensors")
    model = weightfile.load(ROOT / "weights/smrnet.safetensors", torch.float64)
    pixels, _, _ = resize_square(read_picture(ROOT / "tests/fixtures/stages.png"), 96, torch.float64)
    stages: dict[str, torch.Tensor] = {}
    model.detect(normalise(pixels, model.config.mean, model.config.std)[None].contiguous(memory_format=torch.channels_last), stages)
    for name in ("fusion.fused", "rpn.cls", "roi_head.cls_score", "roi_head.bbox_pred", "detections.boxes", "detections.scores"):
        got = stages[name][0] if stages[name].ndim == 4 else stages[name]
        # The goldens are rounded to float32.
        same(f"published, {name}", got, golden[name].double(), 2e-7 * golden[name].abs().max().item())


@torch.no_grad()
def without_the_deepest_scale() -> None:
    model = random_model(Config(**NETWORKS["small"]), 5).double().eval()
    picture = torch.randn(1, 3, 96, 64, dtype=torch.float64).contiguous(memory_format=torch.channels_last)
    whole: dict[str, torch.Tensor] = {}
    model.features(picture, whole)
    maps = [whole[f"fusion.branch{i}"] for i in (1, 2)]
    rw = model.reweight
    pooled = [r(m).mean(dim=(2, 3)) for r, m in zip((rw.reduce1, rw.reduce2), maps)]
    logits = rw.fc2(rw.fc1(torch.cat([*pooled, torch.zeros_like(pooled[0])], dim=1)).relu())
    weights = logits[0, :2].exp() / logits[0, :2].exp().sum()
    less: dict[str, torch.Tensor] = {}
    same("without the deepest scale", model.features(picture, less, 2), weights[0] * maps[0] + weights[1] * maps[1])
    missing = {"backbone.layer4", "backbone.cbam5", "fusion.branch3"}
    assert whole.keys() - less.keys() == missing, whole.keys() - less.keys()


@torch.no_grad()
def peers() -> None:
    """What other programs get of the network is the network: benches/peers takes it apart."""
    sys.path.insert(0, str(ROOT / "benches/peers"))
    import networks

    model = random_model(Config(**NETWORKS["small"]), 6).double().eval()
    picture = torch.randn(1, 3, 96, 64, dtype=torch.float64).contiguous(memory_format=torch.channels_last)
    stages: dict[str, torch.Tensor] = {}
    fused = model.features(picture, stages)
    for name, got in zip(networks.BACKBONE, networks.Backbone(model)(picture), strict=True):
        same(f"peers, {name}", got, stages[name])
    for name, got in zip(networks.FEATURES, networks.Features(model)(picture), strict=True):
        same(f"peers, {name}", got, fused if name == "fusion.fused" else getattr(model.rpn, name.removeprefix("rpn."))(fused))
    pooled = torch.randn(5, model.config.width, 7, 7, dtype=torch.float64)
    heads = model.roi_head(pooled, {})
    for name, got, wanted in zip(("scores", "regression"), networks.RoiHead(model)(pooled), (heads.scores, heads.regression)):
        same(f"peers, {name}", got, wanted)


if __name__ == "__main__":
    torch.manual_seed(0)
    gates()
    roi_align()
    anchors_and_coder()
    batches()
    losses_by_hand()
    steps()
    frames()
    pose_decoding()
    pose_likelihoods()
    detections()
    voting()
    calibration()
    deviations()
    networks()
    without_the_deepest_scale()
    peers()
    weight_files()
