"""Experiments: cases x methods x seeds to rows with units; the paper's tables and figures, and the benchmarks written on the same words."""
