"""What the daemon and its commands do with recordings."""
