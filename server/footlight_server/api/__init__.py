"""The gRPC face of the service; the only place that imports grpc."""
