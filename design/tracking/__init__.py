"""Chapter 7: synthesis of tracking gains for a loop over two delay chains."""
