"""ROSS's own example rotor as a file of matrices; run where ROSS is installed.

Nothing else needs it.

python ross_matrices.py            # writes ross_example.npz beside this script
"""

from pathlib import Path

import numpy as np
import ross

rotor = ross.rotor_example()
degrees = [6 * node + d for node in rotor.nodes for d in (0, 1, 3, 4)]  # x, y, tilts
chosen = np.ix_(degrees, degrees)
parts = {"M": rotor.M(0.0), "K": rotor.K(0.0), "G": rotor.G()}
np.savez_compressed(
    Path(__file__).with_name("ross_example.npz"), **{k: m[chosen] for k, m in parts.items()}
)
