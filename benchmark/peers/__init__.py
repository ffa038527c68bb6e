# SPDX-License-Identifier: Apache-2.0
"""The same problems with other libraries, each as fast as we could make it."""
