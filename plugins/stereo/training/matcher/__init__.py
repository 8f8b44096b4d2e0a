"""What the scripts that train the matcher `stereo_net` share."""
