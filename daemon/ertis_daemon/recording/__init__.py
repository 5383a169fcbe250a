"""Recordings of what just happened: the pings before a trigger, and some after it."""
