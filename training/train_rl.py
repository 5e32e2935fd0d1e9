"""Train PPO or MaskablePPO (stable-baselines3) on a task: one readable script.

    python -m nbv_gym.training.train_rl --task six_directions --total-steps 200000 --num-envs 16 --num-threads 2
    python -m nbv_gym.training.train_rl --algorithm ppo --scene room:0-15 --seed 1 --out out/ppo

Needs the extra `train`. On shared cores set OMP_WAIT_POLICY=PASSIVE or keep torch at one thread, which is the default.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints


@dataclass
class Args:
    """What is trained, on what, how long."""

    #: A task of nbv_gym.envs.suite.
    task: str = "six_directions"
    #: A world file or generated scenes; the task's own if empty.
    scene: str = ""
    #: maskable_ppo never takes a view that the belief forbids; ppo may.
    algorithm: str = "maskable_ppo"
    total_steps: int = 200_000
    num_envs: int = 16
    #: Threads that step the environments.
    num_threads: int = 1
    #: Threads of torch.
    torch_threads: int = 1
    seed: int = 0
    #: Steps per environment between updates.
    n_steps: int = 64
    batch_size: int = 256
    n_epochs: int = 4
    learning_rate: float = 3e-4
    gamma: float = 0.95
    gae_lambda: float = 0.95
    ent_coef: float = 0.01
    #: Rewards are divided by a running estimate of their scale.
    normalise_reward: bool = True
    #: Folder for the model and its log.
    out: str = "out/train"


def parse(arguments: list[str] | None = None) -> Args:
    """Args from the command line; every field is an option."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    types = get_type_hints(Args)
    for option in dataclasses.fields(Args):
        name, kind = "--" + option.name.replace("_", "-"), types[option.name]
        if kind is bool:
            parser.add_argument(name, action=argparse.BooleanOptionalAction, default=option.default)
        else:
            parser.add_argument(name, type=kind, default=option.default, help=f"default: {option.default}")
    return Args(**vars(parser.parse_args(arguments)))


def train(args: Args) -> Any:
    """Train and save; returns the model."""
    import torch
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

    from .sb3_vec_env import Sb3VecEnv

    algorithms: dict[str, Any] = {"ppo": PPO, "maskable_ppo": MaskablePPO}
    if args.algorithm not in algorithms:
        raise ValueError(f"algorithm must be one of {', '.join(algorithms)}, got {args.algorithm!r}")
    torch.set_num_threads(args.torch_threads)
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    (out / "args.json").write_text(json.dumps(dataclasses.asdict(args), indent=1) + "\n", encoding="utf-8")

    settings = {"scene": args.scene} if args.scene else {}
    native = Sb3VecEnv(args.task, args.num_envs, num_threads=args.num_threads, **settings)
    # The metrics of the last step of each episode go into the monitor file.
    env: VecEnv = VecMonitor(native, str(out / "monitor.csv"), info_keywords=("coverage", "path_length"))
    if args.normalise_reward:
        env = VecNormalize(env, norm_obs=False, norm_reward=True, gamma=args.gamma)
    policy = "MultiInputPolicy" if hasattr(native.observation_space, "spaces") else "MlpPolicy"
    model = algorithms[args.algorithm](
        policy,
        env,
        learning_rate=args.learning_rate,
        n_steps=args.n_steps,
        batch_size=args.batch_size,
        n_epochs=args.n_epochs,
        gamma=args.gamma,
        gae_lambda=args.gae_lambda,
        ent_coef=args.ent_coef,
        seed=args.seed,
    )
    model.set_logger(configure(str(out), ["stdout", "csv"]))
    try:
        model.learn(args.total_steps)
    finally:
        # What was learnt is kept after Ctrl-C, too.
        model.save(out / "model.zip")
        env.close()
    return model


if __name__ == "__main__":
    train(parse())
