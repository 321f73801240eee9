"""What each call needs: the one table from methods to scopes. A method that is not in it cannot be called."""

from footlight_server.farm.tokens import Scope

_READ, _SUBMIT, _ADMIN = Scope.READ, Scope.SUBMIT, Scope.ADMIN

# None: nobody is asked for a token. That a server is up may be known to whoever has to restart it.
SCOPES: dict[str, Scope | None] = {
    "/footlight.v1.RenderService/CreateRender": _SUBMIT,
    "/footlight.v1.RenderService/GetRender": _READ,
    "/footlight.v1.RenderService/ListRenders": _READ,
    "/footlight.v1.RenderService/CancelRender": _SUBMIT,
    "/footlight.v1.RenderService/WatchRender": _READ,
    "/footlight.v1.RenderService/GetResult": _READ,
    # It opens a stage in a worker, as a render does.
    "/footlight.v1.StageService/ExplainStage": _SUBMIT,
    "/footlight.v1.JobService/CreateJob": _SUBMIT,
    "/footlight.v1.JobService/GetJob": _READ,
    "/footlight.v1.JobService/ListJobs": _READ,
    "/footlight.v1.JobService/ListTasks": _READ,
    "/footlight.v1.JobService/ListAttempts": _READ,
    "/footlight.v1.JobService/ListFrames": _READ,
    "/footlight.v1.JobService/PauseJob": _SUBMIT,
    "/footlight.v1.JobService/ResumeJob": _SUBMIT,
    "/footlight.v1.JobService/CancelJob": _SUBMIT,
    "/footlight.v1.JobService/RetryTasks": _SUBMIT,
    "/footlight.v1.JobService/SkipTasks": _SUBMIT,
    "/footlight.v1.JobService/ExplainWait": _READ,
    "/footlight.v1.JobService/WatchJob": _READ,
    "/footlight.v1.JobService/ReadLog": _READ,
    "/footlight.v1.JobService/GetFrame": _READ,
    "/footlight.v1.JobService/PruneJobs": _SUBMIT,
    "/footlight.v1.JobService/SetLimit": _ADMIN,
    "/footlight.v1.JobService/ListLimits": _READ,
    "/footlight.v1.JobService/ListWorkers": _READ,
    "/footlight.v1.BlobService/FindMissingBlobs": _SUBMIT,
    "/footlight.v1.BlobService/UploadBlobs": _SUBMIT,
    "/footlight.v1.BlobService/WriteBlob": _SUBMIT,
    "/footlight.v1.BlobService/GetUpload": _SUBMIT,
    "/footlight.v1.TokenService/CreateToken": _ADMIN,
    "/footlight.v1.TokenService/ListTokens": _ADMIN,
    "/footlight.v1.TokenService/RevokeToken": _ADMIN,
    "/grpc.health.v1.Health/Check": None,
    "/grpc.health.v1.Health/List": _READ,
    "/grpc.health.v1.Health/Watch": _READ,
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo": _READ,
}
