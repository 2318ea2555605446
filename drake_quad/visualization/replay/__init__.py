"""Three-dimensional views of flights: live in a browser, or as an HTML page that any browser can replay."""
