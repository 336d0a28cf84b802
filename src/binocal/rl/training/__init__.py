"""Training of agents: networks, replay buffer, TD3, imitation of a target action, run folders. PyTorch is imported here alone."""
