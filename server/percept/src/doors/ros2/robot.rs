//! One robot: its topics found, its sensors declared, its messages handed on as frames.

use super::super::grpc::Api;
use super::super::zenoh::Failure;
use super::book::{Book, Decision, Standing, transforms_sensor};
use super::checks::{check_size, checked, no_message, stamp_of};
use super::clock::Clock;
use super::inbox::{Inbox, Incoming};
use super::link::{self, Found};
use super::mounts::Mounts;
use super::numbers::Numbers;
use super::pairs::{Half, Pairs};
use super::pointed_out::{self, PointedOut};
use super::publish::{Goal, Shared};
use super::settings::Robot;
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp};
use percept_ros::Message;
use percept_ros::cdr::Encoding;
use percept_ros::messages::{CameraInfo, CompressedImage, Image, Imu, LaserScan, Odometry, PointCloud2, TFMessage};
use percept_ros::readings::{Reading, reading};
use percept_ros::rmw_zenoh::Attachment;
use percept_ros::topics::{Content, PAIR_APART_NS};
use percept_service::{Caller, Error, IncomingFrame, NewSession, OverloadPolicy, SensorDeclaration, observe, reason};
use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use zenoh::sample::{Locality, SampleKind};
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig};

/// How often it is looked at what can be decided.
const LOOK: Duration = Duration::from_millis(250);
/// Publishers that are told of and not looked at yet.
const TOKENS: usize = 256;
/// Odometry by transforms is only taken when no topic of odometry has come by then.
const NO_ODOMETRY: Duration = Duration::from_secs(3);

/// What listens to one robot.
pub(super) struct Listener<'a> {
    zenoh: &'a zenoh::Session,
    robot: &'a Robot,
    caller: Caller,
    shared: Arc<Shared>,
    pointed_out: PointedOut,
    inbox: Inbox,
    book: Book,
    /// Alive as long as they are wanted, by topic.
    subscribers: BTreeMap<String, Box<dyn Any + Send + Sync>>,
    /// All that were subscribed to, by topic.
    found: BTreeMap<String, Found>,
    /// By the topic of the depth images.
    pairs: BTreeMap<String, Pairs<Half>>,
    /// By topic.
    numbers: BTreeMap<String, Numbers>,
    /// What is to be said of topics whose types are defined otherwise, by topic.
    strange: BTreeMap<String, String>,
    began: Instant,
    is_session_there: bool,
    tf_sensor: Option<SensorId>,
    clock: Clock,
    /// Topics whose stamps went back, and that were told so.
    set_back: BTreeSet<String>,
    /// Topics of depth images for which colour is not waited any more.
    colourless: BTreeSet<String>,
    /// Where sensors are declared to be.
    mounts: Mounts,
}

impl<'a> Listener<'a> {
    /// Listens until what it listens with is gone.
    pub(super) async fn serve(
        zenoh: &'a zenoh::Session,
        api: &Api,
        robot: &'a Robot,
        caller: Caller,
        shared: Arc<Shared>,
        goals: mpsc::Sender<Goal>,
    ) -> Result<(), Failure> {
        let (inbox, mut incoming) = Inbox::new(&api.bounds.memory, &robot.session);
        let mut this = Self {
            zenoh,
            robot,
            caller,
            shared,
            pointed_out: PointedOut::new(goals),
            inbox,
            book: Book::default(),
            subscribers: BTreeMap::new(),
            found: BTreeMap::new(),
            pairs: BTreeMap::new(),
            numbers: BTreeMap::new(),
            strange: BTreeMap::new(),
            began: Instant::now(),
            is_session_there: false,
            tf_sensor: None,
            clock: Clock::Unset(None),
            set_back: BTreeSet::new(),
            colourless: BTreeSet::new(),
            mounts: Mounts::default(),
        };
        let (token, mut tokens) = mpsc::channel(TOKENS);
        let _tokens = zenoh
            .liveliness()
            .declare_subscriber(link::liveliness_key(robot))
            .history(true)
            .callback(move |sample| {
                if sample.kind() == SampleKind::Put {
                    drop(super::super::zenoh::hand_over(&token, sample.key_expr().as_str().to_owned()));
                }
            })
            .await?;
        let own_zid = zenoh.zid().to_string();
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                token = tokens.recv() => match token {
                    Some(token) => this.look_at(link::found(robot, &token, &own_zid)).await?,
                    None => return Ok(()),
                },
                sample = incoming.recv() => match sample {
                    Some(sample) => this.take(sample).await,
                    None => return Ok(()),
                },
                _ = look.tick() => this.decide().await?,
            }
        }
    }

    /// Subscribes to a topic that is wanted.
    async fn look_at(&mut self, found: Option<Found>) -> Result<(), Failure> {
        let Some(found) = found else { return Ok(()) };
        let is_pointed_out = pointed_out::is_wanted(self.robot, &found);
        self.shared.note(&found, self.robot);
        if found.is_of_other_definition {
            let words = format!(
                "its definition of {} is not percept's: of another distribution, or another type of the same name; messages \
                 are read as percept's, and refused where they do not fit",
                found.type_name
            );
            tracing::warn!(session = self.robot.session, topic = found.topic, words, "another definition");
            self.strange.insert(found.topic.clone(), words);
        }
        let is_wanted = if is_pointed_out {
            !self.subscribers.contains_key(&found.topic)
        } else {
            self.book.add(self.robot, &found.topic, &found.type_name)
        };
        if !is_wanted {
            return Ok(());
        }
        tracing::info!(session = self.robot.session, topic = found.topic, kind = found.type_name, "ROS 2 topic found");
        self.subscribe(&found).await?;
        self.found.insert(found.topic.clone(), found);
        Ok(())
    }

    async fn subscribe(&mut self, found: &Found) -> Result<(), Failure> {
        let (topic, inbox): (Arc<str>, Inbox) = (found.topic.as_str().into(), self.inbox.clone());
        let subscriber = self.zenoh.declare_subscriber(found.key.clone()).allowed_origin(Locality::Remote);
        let put = move |sample: zenoh::sample::Sample| inbox.put(&topic, sample);
        let subscriber: Box<dyn Any + Send + Sync> = if found.is_latched {
            let history = HistoryConfig::default().detect_late_publishers();
            Box::new(subscriber.history(history).callback(put).await?)
        } else {
            Box::new(subscriber.callback(put).await?)
        };
        self.subscribers.insert(found.topic.clone(), subscriber);
        Ok(())
    }

    /// Time since the robot was found.
    fn now(&self) -> Duration {
        self.began.elapsed()
    }

    /// Takes what can be taken by now.
    async fn decide(&mut self) -> Result<(), Failure> {
        if !self.is_session_there && self.book.topics.values().any(|h| h.topic.content.is_sensing()) {
            self.begin_session().await;
        }
        if !self.is_session_there {
            return Ok(());
        }
        {
            let mut known = self.shared.lock();
            (known.base, known.root) = (self.book.base(self.robot), self.book.root(self.robot));
        }
        for topic in self.book.calibrated() {
            let Some(found) = self.found.get(&topic).cloned() else { continue };
            tracing::info!(
                session = self.robot.session,
                topic,
                "ROS 2 topic is looked at again: its calibration has come"
            );
            self.tell(&topic, None).await;
            self.subscribe(&found).await?;
        }
        for decision in self.book.decide(self.robot, self.now()) {
            match decision {
                Decision::Take { topic, spec, color, supposed } => self.declare(topic, *spec, color, supposed).await,
                Decision::Leave { topic, why, .. } => self.leave(&topic, &why).await,
            }
        }
        self.tell_mounts().await;
        if self.tf_sensor.is_none() && self.now() >= NO_ODOMETRY && self.book.odometry_by_transforms() {
            let spec = transforms_sensor();
            let id = spec.id.clone();
            match self.declared(spec).await {
                Ok(_) => {
                    tracing::info!(session = self.robot.session, "odometry is taken from transforms: no topic has it");
                    self.tf_sensor = Some(id);
                }
                Err(error) => self.warn("tf", &error),
            }
        }
        Ok(())
    }

    async fn begin_session(&mut self) {
        let new = NewSession {
            id: Some(self.robot.session.clone()),
            display_name: String::new(),
            labels: [("source".to_owned(), "ros2".to_owned())].into(),
            mode: percept_service::SessionMode::default(),
            sensors: vec![],
            params: self.caller.params_to_fill().clone(),
            request_id: String::new(),
        };
        match self.caller.create_session(new).await {
            Ok(_) => tracing::info!(session = self.robot.session, "session made for a robot on ROS 2"),
            Err(error) if error.reason == reason::SESSION_EXISTS => {}
            Err(error) => return self.warn("session", &error),
        }
        self.is_session_there = true;
    }

    async fn declare(&mut self, topic: String, spec: SensorSpec, color: Option<String>, supposed: Option<String>) {
        let session = self.robot.session.as_str();
        let (sensor, kind) = (spec.id.clone(), spec.kind);
        let t_base_sensor = match self.declared(spec).await {
            Ok(t_base_sensor) => t_base_sensor,
            Err(error) => {
                self.leave(&topic, &error.to_string()).await;
                if let Some(heard) = self.book.topics.get_mut(&topic) {
                    heard.standing = Standing::Left(error.to_string());
                }
                return;
            }
        };
        if let Some(heard) = self.book.topics.get(&topic).filter(|_| kind != SensorKind::Odometry) {
            self.mounts.note(&topic, &heard.topic.frame_id, t_base_sensor);
        }
        if let Some(words) = &supposed {
            tracing::warn!(session, words, "a mount is supposed");
        }
        let words: Vec<String> = supposed.into_iter().chain(self.strange.get(&topic).cloned()).collect();
        self.tell(&topic, (!words.is_empty()).then(|| words.join("; "))).await;
        tracing::info!(session, topic, color, %sensor, ?kind, "ROS 2 topic is a sensor");
        if color.is_some() {
            self.pairs.insert(topic, Pairs::default());
        }
    }

    /// Tells of sensors that are declared to be elsewhere than their transforms say.
    async fn tell_mounts(&mut self) {
        let Some(base) = self.book.base(self.robot) else { return };
        for (topic, words) in self.mounts.contradicted(&self.book.frames, &base) {
            tracing::warn!(session = self.robot.session, topic, words, "another mount");
            self.tell(&topic, Some(words)).await;
        }
    }

    /// Declares a sensor; where it is declared to be. One that is declared already stays as it is: somebody may have put it right.
    async fn declared(&self, spec: SensorSpec) -> Result<Pose, Error> {
        let session = self.robot.session.as_str();
        let known = self.caller.list_sensors(session).await?;
        if let Some(known) = known.iter().find(|s| s.declaration.spec.id == spec.id) {
            let (is, was) = (spec.kind, known.declaration.spec.kind);
            if is == was {
                return Ok(known.declaration.spec.t_base_sensor);
            }
            let words = format!("the sensor {} is declared as {was:?}, and its topic has {is:?}", spec.id);
            return Err(Error::invalid(reason::SENSOR_IN_USE, "sensor_id", words));
        }
        let t_base_sensor = spec.t_base_sensor;
        let declaration = SensorDeclaration { spec, overload: OverloadPolicy::default() };
        self.caller.declare_sensor(session, declaration).await.map(|_| t_base_sensor)
    }

    async fn leave(&mut self, topic: &str, why: &str) {
        tracing::info!(session = self.robot.session, topic, why, "ROS 2 topic is left");
        self.tell(topic, Some(format!("not used: {why}"))).await;
        self.subscribers.remove(topic);
    }

    async fn tell(&self, topic: &str, words: Option<String>) {
        self.caller.note_stream(&self.robot.session, topic, words).await;
    }

    fn warn(&self, what: &str, error: &Error) {
        let (session, kind) = (self.robot.session.as_str(), format!("ros2 {} {what}", self.robot.session));
        if let Some(untold) = self.caller.faults().admit(&format!("{kind} {}", error.reason)) {
            tracing::warn!(session, what, reason = error.reason, untold, %error, "ROS 2 message is not taken");
        }
    }

    async fn take(&mut self, incoming: Incoming) {
        let name = Arc::clone(&incoming.topic);
        if let Err(error) = self.taken(&incoming).await {
            if error.reason == reason::SESSION_NOT_FOUND {
                // Somebody has deleted it: the robot is still there, and begins another.
                self.is_session_there = false;
                self.tf_sensor = None;
                self.clock = Clock::Unset(None);
                self.set_back.clear();
                self.mounts = Mounts::default();
                self.book.begin_anew();
                return;
            }
            observe::frame_refused(None, error.reason);
            if let Some(Standing::Taken(sensor)) = self.book.topics.get(&*name).map(|h| h.standing.clone()) {
                self.caller.rejected(&self.robot.session, &sensor, &error).await;
            }
            if error.reason == reason::CLOCK_SET_BACK && self.set_back.insert(name.to_string()) {
                let words = "its stamps went back, as those of a simulation that begins again, or a recording that is played \
                             again: delete the session, and another begins by itself";
                self.tell(&name, Some(words.to_owned())).await;
            }
            self.warn(&name, &error);
        }
    }

    async fn taken(&mut self, incoming: &Incoming) -> Result<(), Error> {
        let payload = incoming.sample.payload();
        let (size, limit) = (payload.len(), self.caller.limits().max_message_bytes);
        if size > limit {
            let words = format!("message has {size} bytes, the limit is {limit}; thin the cloud or shrink the image");
            return Err(Error::exhausted(reason::MESSAGE_TOO_LARGE, "", words));
        }
        let attachment = incoming.sample.attachment().and_then(|a| Attachment::parse(&a.to_bytes()).ok());
        let sequence = attachment.map_or(0, |a| self.numbers.entry(incoming.topic.to_string()).or_default().of(&a));
        let sent_ns = attachment.map_or(0, |a| a.source_time_ns);
        let name = &*incoming.topic;
        if let Some(taken) = self.pointed_out.take(self.robot, &self.caller, name, &payload.to_bytes()) {
            return taken;
        }
        self.book.heard(name, self.began.elapsed());
        let Some(heard) = self.book.topics.get(name) else { return Ok(()) };
        let (content, standing) = (heard.topic.content.clone(), heard.standing.clone());
        if matches!(standing, Standing::Taken(_) | Standing::ColorOf(_)) {
            let stamp_ns = checked(&payload.to_bytes(), &heard.topic.frame_id)?;
            self.clock.note(stamp_ns, sent_ns)?;
        }
        match (content, standing) {
            (Content::Transforms, _) => self.transforms(name, &payload.to_bytes()).await,
            (Content::Calibration { .. }, _) => {
                let bytes = payload.to_bytes();
                let info = CameraInfo::decode(&bytes).map_err(no_message)?;
                self.book.topics.get_mut(name).into_iter().for_each(|h| h.topic.note_calibration(&info));
                Ok(())
            }
            (content, Standing::Open) => self.note(name, &content, &payload.to_bytes()),
            (content, Standing::Taken(sensor)) => {
                let half = (sequence, sent_ns, payload.clone());
                match self.pairs.get_mut(name) {
                    Some(pairs) => {
                        let stamp = stamp_of(&content, payload, sent_ns)?;
                        match pairs.depth(stamp, half.clone()) {
                            Some((depth, color)) => {
                                self.paired(name).await;
                                self.offer(&content, sensor, depth, Some(color)).await
                            }
                            None if pairs.is_hopeless() => {
                                if self.colourless.insert(name.to_owned()) {
                                    let words = format!(
                                        "taken without colour: none of its colour images was made within {} ms of a depth image",
                                        PAIR_APART_NS / 1_000_000
                                    );
                                    tracing::warn!(
                                        session = self.robot.session,
                                        topic = name,
                                        words,
                                        "depth without colour"
                                    );
                                    self.tell(name, Some(words)).await;
                                }
                                self.offer(&content, sensor, half, None).await
                            }
                            None => Ok(()),
                        }
                    }
                    None => self.offer(&content, sensor, half, None).await,
                }
            }
            (content, Standing::ColorOf(depth)) => {
                let stamp = stamp_of(&content, payload, sent_ns)?;
                let half = (sequence, sent_ns, payload.clone());
                let pair = self.pairs.get_mut(&depth).and_then(|pairs| pairs.color(stamp, half));
                let of_depth = self.book.topics.get(&depth).map(|h| (h.topic.content.clone(), h.standing.clone()));
                match (pair, of_depth) {
                    (Some((image, color)), Some((content, Standing::Taken(sensor)))) => {
                        self.paired(&depth).await;
                        self.offer(&content, sensor, image, Some(color)).await
                    }
                    _ => Ok(()),
                }
            }
            (_, Standing::Beside | Standing::Left(_) | Standing::Uncalibrated) => Ok(()),
        }
    }

    /// A depth image has its colour: what was said of none is over.
    async fn paired(&mut self, topic: &str) {
        if self.colourless.remove(topic) {
            self.tell(topic, None).await;
        }
    }

    /// Notes what a message says of its topic.
    fn note(&mut self, name: &str, content: &Content, bytes: &[u8]) -> Result<(), Error> {
        let Some(heard) = self.book.topics.get_mut(name) else { return Ok(()) };
        let topic = &mut heard.topic;
        match content {
            Content::Scan => topic.note(&LaserScan::decode(bytes).map_err(no_message)?.header),
            Content::Cloud => topic.note(&PointCloud2::decode(bytes).map_err(no_message)?.header),
            Content::Imu => topic.note(&Imu::decode(bytes).map_err(no_message)?.header),
            Content::Odometry => {
                let message = Odometry::decode(bytes).map_err(no_message)?;
                topic.note(&message.header);
                message.child_frame_id.clone_into(&mut topic.child_frame_id);
            }
            Content::Depth { compressed: false, .. } | Content::Color { compressed: false, .. } => {
                topic.note_image(&Image::decode(bytes).map_err(no_message)?);
            }
            Content::Depth { .. } | Content::Color { .. } => {
                topic.note_compressed(&CompressedImage::decode(bytes).map_err(no_message)?);
            }
            Content::Calibration { .. } | Content::Transforms | Content::Other => {}
        }
        Ok(())
    }

    async fn transforms(&mut self, topic: &str, bytes: &[u8]) -> Result<(), Error> {
        let message = TFMessage::decode(bytes).map_err(no_message)?;
        let taken = self.book.frames.take(&message);
        if !topic.ends_with("_static") {
            self.book.note_moving(message.transforms.iter().map(|t| t.child_frame_id));
        }
        let bare = |frame: &str| frame.trim_start_matches('/').to_owned();
        for t in &message.transforms {
            if bare(t.header.frame_id) == self.robot.map_frame
                && self.book.hangs_on(self.robot, &bare(t.child_frame_id))
            {
                self.shared.lock().tf_taken = Some(Instant::now());
            }
        }
        let root = self.book.root(self.robot);
        let odom = root.as_ref().map_or(self.robot.odom_frame.as_str(), |root| root.frame.as_str());
        let of_odometry = |t: &&percept_ros::messages::TransformStamped<'_>| bare(t.header.frame_id) == odom;
        let base = self.book.base(self.robot);
        // What stays where the robot is tells nothing of its motion.
        let moves = root.as_ref().is_none_or(|root| root.t_root_base.is_none() || root.frame == self.robot.odom_frame);
        if moves
            && let Some(t) = message.transforms.iter().find(of_odometry)
            && let Some(t_odom_base) = base.and_then(|base| self.book.frames.t_a_b(odom, &base))
        {
            let stamp = Timestamp::from(t.header.stamp);
            // A body that is held by its footprint, say, is no odometry.
            if odom.to_lowercase().contains("odom") || odom == self.robot.odom_frame {
                self.book.note_odometry();
            }
            self.shared.moved(topic, stamp, t_odom_base);
            if let Some(sensor) = self.tf_sensor.clone() {
                let data = SensorData::Odometry(OdometrySample { t_odom_base, covariance: None });
                self.hand_on(sensor, 0, bytes.len(), Reading { stamp, data }).await?;
            }
        }
        taken.map_err(|e| Error::invalid(reason::MESSAGE_INVALID, "", e.to_string()))
    }

    /// Reads a message, or a depth image and its colour, and hands it on.
    async fn offer(
        &self,
        content: &Content,
        sensor: SensorId,
        message: Half,
        color: Option<Half>,
    ) -> Result<(), Error> {
        let (sequence, sent_ns, payload) = message;
        let limits = Arc::clone(self.caller.limits());
        let size = payload.len() + color.as_ref().map_or(0, |c| c.2.len());
        let (content, max_pixels) = (content.clone(), limits.max_image_pixels as u64);
        let is_small = matches!(content, Content::Imu | Content::Odometry);
        let read = move || {
            let color = color.as_ref().map(|c| c.2.to_bytes());
            reading(&content, Encoding::CdrLittleEndian, &payload.to_bytes(), color.as_deref(), max_pixels)
        };
        let session = self.robot.session.as_str();
        let read = if is_small { read() } else { self.caller.decode(session, read).await? };
        let mut read = read.map_err(|e| Error::invalid(reason::MESSAGE_INVALID, "", e.to_string()))?;
        check_size(&read.data, &limits)?;
        if read.stamp.0 == 0 {
            read.stamp = Timestamp(sent_ns);
        }
        self.hand_on(sensor, sequence, size, read).await
    }

    async fn hand_on(&self, sensor: SensorId, sequence: u64, size: usize, reading: Reading) -> Result<(), Error> {
        let session = self.robot.session.clone();
        if reading.stamp.0 < 0 {
            let words = format!("the stamp is {} ns; set the robot's clock", reading.stamp.0);
            return Err(Error::invalid(reason::STAMP_NEGATIVE, "header.stamp", words));
        }
        self.caller.admit_frame(&session, size)?;
        let frame = SensorFrame { sensor, stamp: reading.stamp, data: reading.data };
        self.caller.offer_frame(IncomingFrame { session, sequence, frame }).await
    }
}
