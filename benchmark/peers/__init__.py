# SPDX-License-Identifier: Apache-2.0
"""The same problems in the words of other libraries, each as fast as we could write it."""
