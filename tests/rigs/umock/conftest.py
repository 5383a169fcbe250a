# They run in processes of their own, server.py under the system's python with its gi module.
collect_ignore = ["server.py", "usbfs.py", "job.py"]
