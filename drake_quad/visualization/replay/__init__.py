"""Three-dimensional views of flights: live in a browser, or as a page that any browser can replay."""
