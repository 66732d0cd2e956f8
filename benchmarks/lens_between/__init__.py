"""A candidate: the transfer of any lens from two distances, measured beside the Gaussian in use."""
