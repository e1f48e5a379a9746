"""Gymnasium and PettingZoo environments, whoever acts in them; no RL library is needed.

`rollout.py` plays episodes of many at once, `references.py` plays them without a policy. `slots.py`
gives agents that come and go a fixed number of places, `everywhere.py` makes the environments of
many contexts one.
"""
