# Run in an environment of their own.
collect_ignore = ["pyzeros_peer.py", "sdk_peer.py"]
