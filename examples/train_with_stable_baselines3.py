"""Trains Stable-Baselines3's TD3 on the calibration environment: ``python train_with_stable_baselines3.py [steps]``."""

import sys

import gymnasium
import numpy as np
import torch
from stable_baselines3 import TD3
from stable_baselines3.common.noise import NormalActionNoise


def evaluate(model: TD3, title: str, n_episodes: int = 100) -> None:
    """Prints the share of rigs never trained on that arrive at the optimum, and the mean number of steps."""
    env, steps, arrived = gymnasium.make("binocal:binocal/StereoExtrinsics-v0", pool_seed=1), 0, 0
    for seed in range(n_episodes):
        seen, has_arrived, is_late = env.reset(seed=seed)[0], False, False
        while not (has_arrived or is_late):
            seen, _, has_arrived, is_late, _ = env.step(model.predict(seen, deterministic=True)[0])
            steps += 1
        arrived += has_arrived
    print(f"{title}: {arrived / n_episodes:.1%} of {n_episodes} rigs arrived, {steps / n_episodes:.2f} steps each")


torch.set_num_threads(1)  # networks this small are slower when shared among threads
env = gymnasium.make("binocal:binocal/StereoExtrinsics-v0", pool_seed=0, pool_size=256)
noise = NormalActionNoise(np.zeros(6), np.full(6, 0.2))
model = TD3("MlpPolicy", env, gamma=0.97, action_noise=noise, policy_kwargs={"net_arch": [64, 64]}, seed=0)
evaluate(model, "before")
model.learn(total_timesteps=int(sys.argv[1]) if len(sys.argv) > 1 else 5000)
evaluate(model, "after")
