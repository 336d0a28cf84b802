"""External calibration as a Markov decision process, and the agents that learn it. PyTorch is in :mod:`binocal.rl.training` alone."""
