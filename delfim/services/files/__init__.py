"""Files and programs from outside: ftpd, sshd, the jail around both, and where clients may write."""
