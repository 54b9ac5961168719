# SPDX-License-Identifier: Apache-2.0
"""The parts of scripts/evaluate.py: sequences, runs, tables."""
