"""Scenes, lenses and photographs of which all is known; nothing is shared with `simulation`."""
