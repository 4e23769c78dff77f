"""Programs that compute the tables and draw the pictures of these pages."""
