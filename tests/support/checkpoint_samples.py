"""Parts and metadata of checkpoints."""

import numpy as np
import torch

PARTS = {"agent": {"weight": torch.arange(1000.0)}, "buffer": {"slot": np.arange(50)}}
META = {"experiment": "abc", "steps": 7}
