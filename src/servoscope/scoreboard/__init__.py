"""The scoreboard: methods of positioning compared from the same starts, in the same images."""
