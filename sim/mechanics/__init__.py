"""The finger pressed: parametric meshes, elements, contact and the solver."""
