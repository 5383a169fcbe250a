"""Landmark detection: audio in, detections out. Knows no device and no network."""
