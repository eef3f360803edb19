"""Object models from the viewpoint of a rig's fingers: CAD import, reachability, twins."""
