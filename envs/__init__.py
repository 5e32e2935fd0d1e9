"""Environments: what is asked of a planner."""
