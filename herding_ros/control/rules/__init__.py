# SPDX-License-Identifier: Apache-2.0
"""Rules of herding: where dogs should be, given where sheep are. One file a rule."""
