"""Controllers: position, estimators, fuzzy networks that learn, thrust vectoring, attitude, and their cascade."""
