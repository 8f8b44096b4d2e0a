"""What the scripts that train the refiner `stereo_net` share."""
