"""The only place that knows SQL: tables, transactions, and what each call of the queue does in one."""
