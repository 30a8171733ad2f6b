"""Looking back: reads recordings and result files and draws the paper's figures."""
