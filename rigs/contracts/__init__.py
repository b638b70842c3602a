"""What every camera, filter wheel and light must do: the same tests for all implementations and users' own rigs."""
