"""A logged flight beside the same flight as a vehicle predicts it: on open loop, or under its own controller."""
