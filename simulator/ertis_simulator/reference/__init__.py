"""Exact echoes to measure the fast simulator against: offline and in tests, never live.

Everything here solves the wave equation without a free parameter: the series of a rigid sphere
(:mod:`sphere_series`), and boundary elements for a rigid screen of revolution
(:mod:`screen`), of which the landmark's dish is one. Convention: time factor
``exp(-i w t)``; a plane wave of amplitude 1 scatters to ``f exp(i k r) / r``.
"""
