"""Evaluation of recorded data: what is read, what is run on it, and the page that tells."""
