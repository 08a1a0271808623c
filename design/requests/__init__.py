"""What an experiment may ask for: ``[controller] kind = ...`` whose gains are solved when the experiment is composed."""
