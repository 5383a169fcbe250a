"""The daemon around the service loops: several sonars, the host it runs on, what it is told."""
