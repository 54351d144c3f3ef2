"""The weight file: safetensors in f16 and f32, with the configuration as JSON in its metadata."""

import json
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from .config import Config
from .errors import Failure
from .files import whole
from .model import SmrNet


def _stored(tensor: Tensor) -> Tensor:
    """Weights of convolutions and linear layers in f16; vectors (biases, batch norm) in f32.

    A running variance can lie below the f16 range and is divided by; the vectors
    together are 0.1 % of the file.
    """
    half = tensor.ndim > 1
    return tensor.detach().cpu().contiguous().to(torch.float16 if half else torch.float32).clone()


def stored(model: SmrNet) -> dict[str, Tensor]:
    """The file's tensors by name."""
    return {k: _stored(v) for k, v in model.state_dict().items() if not k.endswith("num_batches_tracked")}


def save(model: SmrNet, file: Path) -> None:
    """Always in format 2; whole or not at all."""
    tensors = stored(model)
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise Failure(f"{name}: not finite in {tensor.dtype}: the training has diverged")
    with whole(file, SafetensorError) as part:
        save_file(tensors, part, metadata={"config": json.dumps(model.config.to_dict())})
        part.chmod(0o644)


def load(file: Path, dtype: torch.dtype = torch.float32) -> SmrNet:
    """The network with the rounded weights of a file in format 1 or 2, ready for inference."""
    try:
        with safe_open(file, "pt") as saved:
            config = Config.from_dict(json.loads(saved.metadata()["config"]))
            tensors = {k: saved.get_tensor(k).to(dtype) for k in saved.keys()}
        model = SmrNet(config).to(dtype)
        missing, unexpected = model.load_state_dict(tensors, strict=False)
    except Failure as error:
        raise Failure(f"{file}: {error}") from None
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
        said = " ".join(str(error).split())
        raise Failure(f"{file}: expected a weight file of SMR-Net, got {type(error).__name__}: {said[:300]}") from None
    missing = [k for k in missing if not k.endswith("num_batches_tracked")]
    if missing or unexpected:
        raise Failure(f"{file}: missing {missing}, unexpected {unexpected}")
    return model.to(memory_format=torch.channels_last).eval()
