"""Claims about policies in the dynamics, certified by episodes at a declared confidence."""
