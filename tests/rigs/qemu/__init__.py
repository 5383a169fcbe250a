"""Rig C: a QEMU guest with a stock Debian kernel and a real USB stack. See README.md."""
