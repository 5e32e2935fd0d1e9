"""nbv_gym: Gymnasium environments for 3-D next-best-view planning.

``import nbv_gym`` registers the environments and does nothing else.
"""

from importlib.metadata import version

from gymnasium import register

from .envs.suite import TASKS

__version__ = version("nbv-gym")
__all__ = ["__version__"]

# No max_episode_steps: the budget of views is the task's own truncation.
for name, task in TASKS.items():
    register(
        id=task.id,
        entry_point="nbv_gym.envs.env:NbvEnv",
        vector_entry_point="nbv_gym.envs.vector_env:NbvVectorEnv",
        kwargs={"task": name},
    )
del name, task
