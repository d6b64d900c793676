"""The studio's page: two views and two panels by viser, behind one door."""
