//! Declare sensors, take frames.

use crate::session::meta::SensorDeclaration;
use crate::{IncomingFrame, Processed, Result, SensorStatus, Service, Session};
use percept_geometry::SensorId;
use std::sync::Arc;

impl Service {
    /// Declares a sensor of a session, durably.
    ///
    /// # Errors
    /// `SENSOR_IN_USE`, `TOO_MANY_SENSORS`, `SESSION_NOT_FOUND`.
    pub async fn declare_sensor(&self, session: &str, declaration: SensorDeclaration) -> Result<SensorStatus> {
        let id: SensorId = declaration.spec.id.clone();
        let session = self.registry.declare(session, declaration).await?;
        let status = session.sensors().into_iter().find(|s| s.declaration.spec.id == id);
        status.ok_or_else(|| crate::Error::internal("a sensor just declared is missing"))
    }

    /// Takes one frame and answers when it was processed and is durable.
    ///
    /// # Errors
    /// What is wrong with the frame; limits; faults of the storage.
    pub async fn send_frame(&self, incoming: IncomingFrame) -> Result<(Arc<Session>, Processed)> {
        let session = self.session(&incoming.session).await?;
        session.numbered(&incoming.frame.sensor, incoming.sequence);
        let processed = session.process(incoming.frame).await?;
        session.wait_durable(processed.ticket).await?;
        Ok((session, processed))
    }

    /// Takes a frame from a door that cannot answer: what is wrong is counted and logged.
    pub async fn offer_frame(&self, incoming: IncomingFrame) {
        let sensor = incoming.frame.sensor.clone();
        let outcome = async {
            let session = self.session(&incoming.session).await?;
            session.numbered(&sensor, incoming.sequence);
            session.offer(incoming.frame).await
        };
        if let Err(error) = outcome.await {
            tracing::warn!(session = incoming.session, %sensor, reason = error.reason, %error, "frame refused");
        }
    }

    /// The server's clock, nanoseconds since the Unix epoch.
    pub fn clock_ns(&self) -> i64 {
        super::sessions::now_ns()
    }
}
