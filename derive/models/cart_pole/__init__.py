"""The cart-pole: a force on a cart balances a pole hinged to it."""
