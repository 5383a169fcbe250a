"""The sensor daemon: configuration, service loop, events, publishing, command line."""
