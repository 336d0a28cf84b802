"""External calibration as a Markov decision process, and the agents that learn it. PyTorch stays in this room."""
