"""What is written to folders: by one process at a time, whole or not at all."""
