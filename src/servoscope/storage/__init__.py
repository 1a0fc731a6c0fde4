"""Files and folders: read with care, written by one process at a time, whole or not at all."""
