"""The whole way on a simulated rig."""
