"""The capture model: how a scene looks from further away."""
