"""The paper's experiments: SMR-Net beside its baselines and without its parts, on the same pictures. `python -m smr_gpu_train.experiments`"""
