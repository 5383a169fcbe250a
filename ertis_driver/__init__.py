"""Driver for the eRTIS in-air sonar: frames, audio, chirps, devices, recordings."""
