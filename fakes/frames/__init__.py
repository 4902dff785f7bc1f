"""The twin's camera: rendered colour and depth images of the world, served on a socket."""
