"""Other programs for the same press: decks, CalculiX in a process of its own, results of Abaqus."""
