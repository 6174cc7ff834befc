//! Declare sensors, take frames.

use crate::reason;
use crate::session::command::{Offered, Submitted};
use crate::session::meta::SensorDeclaration;
use crate::{Error, IncomingFrame, Pending, Processed, Result, SensorStatus, Service, Session, check_id};
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

    /// Hands a frame to its session, which is woken if it slept; the answer comes through what is returned.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `SENSOR_NOT_FOUND`; limits; faults of the storage.
    pub async fn submit_frame(&self, incoming: IncomingFrame) -> Result<(Arc<Session>, Pending)> {
        check_id("session_id", &incoming.session)?;
        let mut frame = Box::new(incoming.frame);
        loop {
            let session = self.registry.get(&incoming.session).await?;
            session.numbered(&frame.sensor, incoming.sequence);
            match session.submit(frame).await? {
                Submitted::Taken(pending) => return Ok((session, pending)),
                Submitted::Asleep(given_back) => frame = given_back,
            }
            self.registry.left(&incoming.session, &session).await;
        }
    }

    /// Takes one frame and answers when it was processed and is durable. A frame that is sent again is answered as one that
    /// was taken in, and nothing is done with it.
    ///
    /// # Errors
    /// What is wrong with the frame; limits; faults of the storage; `NOT_YET_DURABLE`.
    pub async fn send_frame(&self, incoming: IncomingFrame) -> Result<(Arc<Session>, Processed)> {
        let (sensor, stamp) = (incoming.frame.sensor.clone(), incoming.frame.stamp);
        let (session, pending) = self.submit_frame(incoming).await?;
        let processed = match pending.answer().await {
            Err(e) if matches!(e.reason, reason::STAMP_NOT_INCREASING | reason::CLOCK_SET_BACK) => {
                session.taken_before(&sensor, stamp).ok_or(e)?
            }
            answer => answer?,
        };
        session.wait_durable(processed.ticket).await?;
        Ok((session, processed))
    }

    /// Takes a frame from a door that cannot answer: what is wrong is counted and logged.
    ///
    /// # Errors
    /// Why it was not taken.
    pub async fn offer_frame(&self, incoming: IncomingFrame) -> Result<()> {
        check_id("session_id", &incoming.session)?;
        let mut frame = Box::new(incoming.frame);
        loop {
            let session = self.registry.get(&incoming.session).await?;
            session.numbered(&frame.sensor, incoming.sequence);
            match session.offer(frame).await? {
                Offered::Taken => return Ok(()),
                Offered::Asleep(given_back) => frame = given_back,
            }
            self.registry.left(&incoming.session, &session).await;
        }
    }

    /// Counts a frame that a door refused before it got here. A session that sleeps is woken: whoever looks at it has to see
    /// what comes.
    pub async fn count_rejected(&self, session: &str, sensor: &SensorId, because: &Error) {
        if let Ok(session) = self.session(session).await {
            session.rejected(sensor, because);
        }
    }

    /// Notes what a door has to say of a stream; none if there is nothing any more. A session that sleeps is woken for words, as one
    /// does that no frame has come for yet.
    pub async fn note_stream(&self, session: &str, stream: &str, message: Option<String>) {
        let found = match message {
            Some(_) => self.session(session).await.ok(),
            None => self.view_session(session).await.ok().and_then(|view| view.live),
        };
        if let Some(session) = found {
            session.note_stream(stream, message);
        }
    }

    /// Notes that the driver of a sensor has gone, in words, or is there again. A session that sleeps is left alone, and what is no
    /// sensor of the session is nothing to note.
    pub async fn note_driver(&self, session: &str, sensor: &SensorId, message: Option<String>) {
        let live = self.view_session(session).await.ok().and_then(|view| view.live);
        let has_it = |session: &Arc<Session>| session.meta().sensors.iter().any(|s| s.spec.id == *sensor);
        if let Some(session) = live.filter(has_it) {
            session.note_stream(&sensor.0, message);
        }
    }

    /// Health of every sensor of a session, without waking it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; faults of the storage.
    pub async fn list_sensors(&self, session: &str) -> Result<Vec<SensorStatus>> {
        check_id("session_id", session)?;
        self.registry.sensors(session).await
    }

    /// Health of one sensor of a session, without waking it.
    ///
    /// # Errors
    /// `SENSOR_NOT_FOUND`, `SESSION_NOT_FOUND`; faults of the storage.
    pub async fn sensor(&self, session: &str, sensor: &SensorId) -> Result<SensorStatus> {
        check_id("sensor_id", &sensor.0)?;
        let mut sensors = self.list_sensors(session).await?.into_iter();
        let found = sensors.find(|status| status.declaration.spec.id == *sensor);
        found.ok_or_else(|| crate::session::refusal::sensor_not_found(sensor))
    }

    /// The server's clock, nanoseconds since the Unix epoch.
    pub fn clock_ns(&self) -> i64 {
        crate::clock::now_ns()
    }
}
