"""A run in a browser: the camera in space over the reference view, images, and what is believed."""
