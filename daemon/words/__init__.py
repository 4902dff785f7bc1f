"""Results, plans, values and journals in words, as the command line and the page show them."""
