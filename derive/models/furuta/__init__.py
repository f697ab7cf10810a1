"""The Furuta pendulum: a motor turns a horizontal arm, which balances a pendulum."""
