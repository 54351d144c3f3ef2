"""Trains SMR-Net, the network of `smr-gpu`, on pictures with labels, and writes its weight file."""

__version__ = "0.1.0"
