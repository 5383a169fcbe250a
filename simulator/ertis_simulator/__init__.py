"""A simulated acoustic world that makes PDM frames as an eRTIS would."""
