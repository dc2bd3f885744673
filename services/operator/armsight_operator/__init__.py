"""Everything of armsight that a person sees: the command line, the stack on one machine, reports."""
