"""A page of a scene and its motion in a browser: what is drawn as arrays, and the page itself."""
