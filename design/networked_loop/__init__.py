"""Plant + delay chains + row rule = a jump-linear system (7.14): closed loop, prediction, uncertainty, bounds."""
