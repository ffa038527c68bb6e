# SPDX-License-Identifier: Apache-2.0
"""What moves: the crowd, the dogs and the noise (NumPy and Numba, no ROS)."""

from .kernel_cache import find_cache

find_cache()  # Numba reads its settings when it is imported
