//! Whether an object store creates atomically: some that speak S3 do not, and two nodes would own one session there.

use futures::future::join_all;
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};

use crate::error::StoreError;

/// What says that the trial was passed here.
const PASSED: &str = "CREATES_ATOMICALLY";
const FOLDER: &str = "trial";
const WRITERS: usize = 16;
const ROUNDS: usize = 8;

/// Lets sixteen writers create one object, eight times; once for each location.
pub(crate) async fn run(objects: &dyn ObjectStore, name: &str) -> Result<(), StoreError> {
    let io = |error| StoreError::from_object("try the object store", error);
    match objects.head(&Path::from(PASSED)).await {
        Ok(_) => return Ok(()),
        Err(Error::NotFound { .. }) => {}
        Err(error) => return Err(io(error)),
    }
    for round in 0..ROUNDS {
        let path = Path::from_iter([FOLDER, name, &round.to_string()]);
        let create =
            || objects.put_opts(&path, PutPayload::from_static(b"percept\n"), PutOptions::from(PutMode::Create));
        let mut num_won = 0;
        for outcome in join_all((0..WRITERS).map(|_| create())).await {
            match outcome {
                Ok(_) => num_won += 1,
                Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => {}
                Err(error) => return Err(io(error)),
            }
        }
        objects.delete(&path).await.map_err(io)?;
        if num_won > 1 {
            return Err(StoreError::CreateNotAtomic { num_won, num_writers: WRITERS });
        }
    }
    objects.put(&Path::from(PASSED), PutPayload::from_static(b"percept\n")).await.map(|_| ()).map_err(io)
}
