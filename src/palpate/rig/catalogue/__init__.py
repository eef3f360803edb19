"""Object models as a rig's fingers meet them: CAD import, reachability, twins."""
