"""Learning an unknown part by touch: bounds of its outline, the next grips, and the model that they allow."""
