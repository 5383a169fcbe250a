"""What the physics allows: the best size, presence and place from one ping, with the true model.

``python -m ertis_simulator.bound`` makes the table again; docs/bound.md says what it means.
"""
