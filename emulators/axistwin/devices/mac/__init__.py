"""MAC23 and MAC34 motors with controller: one axis core, and a family for each kind of wire."""
