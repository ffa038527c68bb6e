# SPDX-License-Identifier: Apache-2.0
"""The crowd that explains a recording: what sheep and dogs did -> parameters, with intervals."""
