# SPDX-License-Identifier: Apache-2.0
"""What moves: the crowd, the dogs and the noise (NumPy and Numba, no ROS)."""
