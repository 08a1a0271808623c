"""An experiment becomes a loop that can run: plug-ins, design, certificate."""
