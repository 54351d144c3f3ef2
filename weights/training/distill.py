"""A small network learns from a large one's fused map, classes and boxes, on the same views and regions."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

import boxes as bx
from losses import Rois, mean_where, of_label
from model import Config, Heads, SmrNet, autocast


# In the sum. The labels teach more than the teacher, whose map a narrow network can only follow in part.
WEIGHTS = {"map": 0.1, "teacher_class": 0.5, "teacher_box": 0.5}


class Distiller(nn.Module):
    """Its parameters are those of the projection, which only training needs; the teacher's stay as they are."""

    def __init__(self, teacher: SmrNet, student: Config):
        super().__init__()
        if teacher.config.classes != student.classes or teacher.config.stride != student.stride:
            raise SystemExit("the teacher's classes and stride: expected the student's")
        self.project = nn.Conv2d(student.width, teacher.config.width, 1)
        # In a list, so that neither the state dict nor train() reaches it.
        self.teachers = [teacher]

    def losses(self, images: Tensor, fused: Tensor, rois: Rois, heads: Heads, wanted: Tensor | None) -> dict[str, Tensor]:
        """`wanted` is the teacher's fused map; without it the teacher runs."""
        (teacher,) = self.teachers
        with autocast(images.device.type):
            with torch.no_grad():
                if wanted is None:
                    wanted = teacher.features(images, {})
                say = teacher.roi_head(bx.roi_align_dense(wanted, rois.boxes, 1 / teacher.config.stride), {})
            guess = self.project(fused)
        wanted = wanted.float()
        probability = say.scores.float().softmax(dim=1)
        used = rois.labels.flatten() >= 0
        # Boxes only where the teacher sees a snap: elsewhere its boxes mean nothing.
        best, label = probability[:, 1:].max(dim=1)
        seen = used & (best > 0.5)
        of = [of_label(h, label + 1) for h in (heads.regression, say.regression.float())]
        box = F.smooth_l1_loss(*of, beta=1 / 9, reduction="none").sum(dim=1)
        divergence = F.kl_div(heads.scores.log_softmax(dim=1), probability, reduction="none").sum(dim=1)
        losses = {
            "map": F.mse_loss(guess.float(), wanted) / wanted.var(),
            "teacher_class": mean_where(divergence, used),
            "teacher_box": box.where(seen, 0.0).sum() / used.sum().clamp(min=1),
        }
        return {name: WEIGHTS[name] * loss for name, loss in losses.items()}
