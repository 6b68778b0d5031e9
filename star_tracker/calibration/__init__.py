"""What a frame tells about the camera: three stars, error propagation, lens, focal length."""
